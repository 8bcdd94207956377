//! The table of commands (command set, chapter 3): the single source of ids, names, parameters, values and status
//! codes.
//!
//! It generates [`command`](crate::command) and [`reply`](crate::reply), and is used for the documentation, the
//! simulator's error replies and the tests.

/// Calls the macro `$make` with all rows of the table:
///
/// `id Name "manual's name" "section" Kind request { parameter: type = "unit" } reply (type = "unit") immediate [..] completion [..];`
///
/// The unit is `""`, or omitted in a reply, if the type's text already includes its units. `immediate` lists the status
/// codes of the first reply and `completion` the codes of the second. Only asynchronous commands have a second reply
/// (command set, 1.3). The lists combine the English and the German manual, with two additions. Loop (06h) has
/// E_SUCCESS, without which it could not return data (1.2.2). Grip Part and Release Part (25h, 26h) have
/// E_NOT_INITIALIZED, because Homing precedes every motion (3.2.1).
macro_rules! for_each_command {
    ($make:ident) => {
        $make! {
            /// Echoes bytes unchanged, to test the connection.
            0x06 Loop "Loop" "3.1.1" Connection
                request {
                    /// The data to echo.
                    data: LoopData<'a> = ""
                }
                reply (LoopData<'a>)
                immediate [Success, CmdFormatError, InvalidParameter, CmdPending] completion [];
            /// Announces the end of a TCP connection so that it does not cause a FAST STOP. Ends a running motion.
            0x07 DisconnectAnnouncement "Disconnect Announcement" "3.1.2" Connection
                request reply
                immediate [Success, NoParamExpected, NotAvailable] completion [];

            /// References the fingers at an end stop.
            0x20 Homing "Homing" "3.2.1" Motion
                request {
                    /// The end stop to move to.
                    direction: HomingDirection = ""
                }
                reply
                immediate [AccessDenied, AlreadyRunning, CmdFormatError, InvalidParameter, CmdPending]
                completion [Success, CmdAborted, AxisBlocked, Timeout];
            /// Moves the fingers to an opening width or by an offset.
            0x21 PrePosition "Pre-position Fingers" "3.2.2" Motion
                request {
                    /// Relative motion and stop on block.
                    flags: PrePositionFlags = "",
                    /// Opening width, or offset to the current one, in mm.
                    width: f32 = "mm",
                    /// Finger speed in mm/s.
                    speed: f32 = "mm/s"
                }
                reply
                immediate [AccessDenied, NotInitialized, AlreadyRunning, RangeError, CmdFormatError, CmdPending]
                completion [Success, InsufficientResources, AxisBlocked, RangeError, Timeout, CmdAborted];
            /// Stops any finger movement. No acknowledgement is needed.
            0x22 Stop "Stop" "3.2.3" Stop
                request reply
                immediate [Success, NoParamExpected, Timeout] completion [];
            /// Stops any finger movement as fast as possible and locks motion until acknowledged.
            0x23 FastStop "Issue FAST STOP" "3.2.4" Stop
                request reply
                immediate [Success] completion [];
            /// Acknowledges a FAST STOP or a fault and unlocks motion.
            0x24 Acknowledge "Acknowledge FAST STOP" "3.2.5" Acknowledge
                request {
                    /// The key `ack`.
                    key: AckKey = ""
                }
                reply
                immediate [Success, CmdFormatError] completion [];
            /// Grips a part of a nominal width with the current force limit.
            0x25 GripPart "Grip Part" "3.2.6" Motion
                request {
                    /// Nominal width of the part in mm.
                    width: f32 = "mm",
                    /// Gripping speed in mm/s.
                    speed: f32 = "mm/s"
                }
                reply
                immediate [AccessDenied, NotInitialized, AlreadyRunning, CmdFormatError, RangeError, CmdPending]
                completion [Success, CmdAborted, CmdFailed, Timeout];
            /// Opens the fingers to release a part.
            0x26 ReleasePart "Release Part" "3.2.7" Motion
                request {
                    /// Opening width in mm.
                    width: f32 = "mm",
                    /// Opening speed in mm/s.
                    speed: f32 = "mm/s"
                }
                reply
                immediate [AccessDenied, NotInitialized, AlreadyRunning, CmdFormatError, RangeError, CmdPending]
                completion [Success, CmdAborted, Timeout];

            /// Sets the acceleration of the following motions, clamped to the gripper's limits.
            0x30 SetAcceleration "Set Acceleration" "3.3.1" Setting
                request {
                    /// Acceleration in mm/s².
                    acceleration: f32 = "mm/s²"
                }
                reply
                immediate [Success, CmdFormatError] completion [];
            /// Queries the acceleration, in mm/s².
            0x31 GetAcceleration "Get Acceleration" "3.3.2" Query
                request reply (f32 = "mm/s²")
                immediate [Success, NoParamExpected] completion [];
            /// Sets the maximum force of the following grips and pre-positions, clamped to the gripper's limits.
            0x32 SetForceLimit "Set Force Limit" "3.3.3" Setting
                request {
                    /// Force, summed over both fingers, in N.
                    force: f32 = "N"
                }
                reply
                immediate [Success, CmdFormatError] completion [];
            /// Queries the force limit, in N, summed over both fingers.
            0x33 GetForceLimit "Get Force Limit" "3.3.4" Query
                request reply (f32 = "N")
                immediate [Success, NoParamExpected] completion [];
            /// Sets the permitted range of the opening width.
            0x34 SetSoftLimits "Set Soft Limits" "3.3.5" Setting
                request {
                    /// The permitted range in mm.
                    limits: SoftLimits = ""
                }
                reply
                immediate [Success, CmdFormatError] completion [];
            /// Queries the soft limits, in mm.
            0x35 GetSoftLimits "Get Soft Limits" "3.3.6" Query
                request reply (SoftLimits)
                immediate [Success, NotAvailable, InsufficientResources, NoParamExpected] completion [];
            /// Clears the soft limits, so the full stroke is permitted.
            0x36 ClearSoftLimits "Clear Soft Limits" "3.3.7" Setting
                request reply
                immediate [Success, NoParamExpected] completion [];
            /// Enables or disables forces up to the overdrive limit.
            0x37 OverdriveMode "Overdrive Mode" "3.3.8" Setting
                request {
                    /// Whether the overdrive limit applies.
                    enabled: bool = ""
                }
                reply
                immediate [Success, CmdFormatError] completion [];
            /// Zeroes the force sensor at the current force.
            0x38 TareForceSensor "Tare Force Sensor" "3.3.9" Setting
                request reply
                immediate [Success, NotAvailable, AccessDenied, NoParamExpected] completion [];

            /// Queries the system state flags, once or with updates.
            0x40 GetSystemState "Get System State" "3.4.1" Query
                request {
                    /// Once, periodically, or on change.
                    update: AutoUpdate = ""
                }
                reply (SystemFlags)
                immediate [Success, CmdFormatError] completion [];
            /// Queries the gripper state, once or with updates.
            0x41 GetGripperState "Get Gripper State" "3.4.2" Query
                request {
                    /// Once, periodically, or on change.
                    update: AutoUpdate = ""
                }
                reply (GripperState)
                immediate [Success, CmdFormatError] completion [];
            /// Queries the gripping statistics and optionally resets them.
            0x42 GetGrippingStatistics "Get Gripping Statistics" "3.4.3" Query
                request {
                    /// Whether to reset the counters to 0.
                    reset: bool = ""
                }
                reply (GrippingStatistics)
                immediate [Success, CmdFormatError] completion [];
            /// Queries the opening width in mm, once or with updates.
            0x43 GetOpeningWidth "Get Opening Width" "3.4.4" Query
                request {
                    /// Once, periodically, or on change (0.01 mm).
                    update: AutoUpdate = ""
                }
                reply (f32 = "mm")
                immediate [Success, CmdFormatError] completion [];
            /// Queries the finger speed in mm/s, once or with updates.
            0x44 GetSpeed "Get Speed" "3.4.5" Query
                request {
                    /// Once, periodically, or on change (0.05 mm/s).
                    update: AutoUpdate = ""
                }
                reply (f32 = "mm/s")
                immediate [Success, CmdFormatError] completion [];
            /// Queries the gripping force in N, summed over both fingers, once or with updates.
            0x45 GetForce "Get Force" "3.4.6" Query
                request {
                    /// Once, periodically, or on change (0.05 N).
                    update: AutoUpdate = ""
                }
                reply (f32 = "N")
                immediate [Success, CmdFormatError] completion [];
            /// Queries the temperature of the device.
            0x46 GetTemperature "Get Temperature" "3.4.7" Query
                request reply (Temperature)
                immediate [Success, NoParamExpected, InsufficientResources] completion [];

            /// Queries device type, versions and serial number.
            0x50 GetSystemInfo "Get System Information" "3.5.1" Query
                request reply (SystemInfo)
                immediate [Success, NoParamExpected, InsufficientResources] completion [];
            /// Sets the device tag, a text of up to 64 characters.
            0x51 SetDeviceTag "Set Device Tag" "3.5.2" Setting
                request {
                    /// The text of the tag.
                    tag: DeviceTag<'a> = ""
                }
                reply
                immediate [Success, Overrun, InvalidParameter, InsufficientResources] completion [];
            /// Queries the device tag.
            0x52 GetDeviceTag "Get Device Tag" "3.5.3" Query
                request reply (DeviceTag<'a>)
                immediate [Success, NoParamExpected, NotAvailable, InsufficientResources] completion [];
            /// Queries the physical limits of the gripper.
            0x53 GetSystemLimits "Get System Limits" "3.5.4" Query
                request reply (SystemLimits)
                immediate [Success, NoParamExpected, InsufficientResources] completion [];

            /// Queries the type of finger 1.
            0x60 GetFinger1Info "Get Finger 1 Info" "3.6.1" Query
                request reply (FingerInfo)
                immediate [Success, CmdFormatError, InsufficientResources] completion [];
            /// Queries the state flags of finger 1.
            0x61 GetFinger1Flags "Get Finger 1 Flags" "3.6.2" Query
                request reply (FingerFlags)
                immediate [Success, CmdFormatError, IndexOutOfBounds, InsufficientResources] completion [];
            /// Switches the supply of finger 1. Switching on takes about 500 ms.
            0x62 Finger1Power "Finger 1 Power Control" "3.6.3" Setting
                request {
                    /// Whether to power the finger.
                    enabled: bool = ""
                }
                reply
                immediate [Success, CmdFormatError, CmdFailed, CmdPending] completion [Success];
            /// Queries one data frame of finger 1.
            0x63 GetFinger1Data "Get Finger 1 Data" "3.6.4" Query
                request reply (FingerData<'a>)
                immediate [Success, CmdFormatError, IoError, NotAvailable] completion [];
            /// Queries the type of finger 2.
            0x70 GetFinger2Info "Get Finger 2 Info" "3.6.5" Query
                request reply (FingerInfo)
                immediate [Success, CmdFormatError, InsufficientResources] completion [];
            /// Queries the state flags of finger 2.
            0x71 GetFinger2Flags "Get Finger 2 Flags" "3.6.6" Query
                request reply (FingerFlags)
                immediate [Success, CmdFormatError, InsufficientResources] completion [];
            /// Switches the supply of finger 2. Switching on takes about 500 ms.
            0x72 Finger2Power "Finger 2 Power Control" "3.6.7" Setting
                request {
                    /// Whether to power the finger.
                    enabled: bool = ""
                }
                reply
                immediate [Success, CmdFormatError, CmdFailed, CmdPending] completion [Success];
            /// Queries one data frame of finger 2.
            0x73 GetFinger2Data "Get Finger 2 Data" "3.6.8" Query
                request reply (FingerData<'a>)
                immediate [Success, CmdFormatError, IoError, NotAvailable] completion [];
        }
    };
}
pub(crate) use for_each_command;

//! The table of commands (GCL, chapters 2 and 3): names, sections, forms and answers.
//!
//! [`Request`](super::Request), [`Value`](super::Value), [`CommandName`](super::CommandName) and the table in `docs/gcl.md`
//! derive from it.

/// Calls the macro `$make` with every row of the table:
///
/// `Variant "NAME" "section" Kind unit Form | with (Parameters) answers [Ack, Fin] value (Type);`
///
/// A request consists of the name and a [`Form`](super::form::Form), either without data (`unit`) or with a parameter type
/// (`with`). The gripper acknowledges it, reports its end by `Fin`, or answers with a value.
macro_rules! for_each_gcl_command {
    ($make:ident) => {
        $make! {
            /// Sets whether errors are answered with a text in addition to the status code.
            Verbose "VERBOSE" "2.1.1" Setting with (bool) answers [] value (bool);
            /// Announces the end of the connection, so that closing it triggers no FAST STOP.
            Bye "BYE" "2.1.2" Connection unit Call answers [Ack] value ();

            /// Homes the fingers at an end stop.
            Home "HOME" "2.2.1" Motion with (HomingDirection) answers [Ack, Fin] value ();
            /// Moves the fingers to an opening width; a block is an error.
            Move "MOVE" "2.2.2" Motion with (Move) answers [Ack, Fin] value ();
            /// Grips a part.
            Grip "GRIP" "2.2.3" Motion with (Grip) answers [Ack, Fin] value ();
            /// Opens the fingers after a GRIP, by a distance.
            Release "RELEASE" "2.2.4" Motion with (Release) answers [Ack, Fin] value ();
            /// Part width tolerance in mm for this connection: the maximum distance before the nominal width at which a part
            /// counts as found.
            Pwt "PWT" "2.2.5" Setting with (Setting) answers [] value (f32);
            /// Clamping travel in mm for this connection: the maximum travel after contact to build up the gripping force.
            Clt "CLT" "2.2.6" Setting with (Setting) answers [] value (f32);

            /// Opening width in mm.
            Pos "POS" "2.3.1" Query unit Ask answers [] value (f32);
            /// Speed of the fingers relative to each other, in mm/s.
            Speed "SPEED" "2.3.2" Query unit Ask answers [] value (f32);
            /// Gripping force in N.
            Force "FORCE" "2.3.3" Query unit Ask answers [] value (f32);
            /// Gripper state.
            Gripstate "GRIPSTATE" "2.3.4" Query unit Ask answers [] value (GripperState);

            /// Device type, such as `WSG 32-068`.
            Devtype "DEVTYPE" "3.1.1" Query unit Ask answers [] value (Text<'a>);
            /// Firmware version, such as `4.0.0`.
            Version "VERSION" "3.1.2" Query unit Ask answers [] value (Text<'a>);
            /// Serial number.
            Sn "SN" "3.1.3" Query unit Ask answers [] value (u32);
            /// Device tag. `DEVTAG`, the name in the manual's example, is accepted as well.
            Tag "TAG" "3.1.4" Query unit Ask answers [] value (DeviceTag<'a>);
            /// System state flags, or one of them; the first is D0.
            Sysflags "SYSFLAGS" "3.1.5" Query with (Select<32>) answers [] value (Selected<SystemFlags, bool, 32>);
            /// Temperature of the device in °C.
            Temp "TEMP" "3.1.6" Query unit Ask answers [] value (f32);
            /// Starts or ends periodic updates of a value, marked by `@`.
            Autosend "AUTOSEND" "3.1.7" Setting with (Autosend) answers [Ack] value ();

            /// Stops any finger movement; needs no acknowledgement.
            Stop "STOP" "3.2.1" Stop unit Call answers [Ack] value ();
            /// Stops any finger movement as fast as possible and locks motion until FSACK.
            Faststop "FASTSTOP" "3.2.2" Stop unit Call answers [Ack] value ();
            /// Acknowledges a FAST STOP, which unlocks motion.
            Fsack "FSACK" "3.2.3" Acknowledge unit Call answers [Ack] value ();

            /// Zeroes force measurement fingers (WSG-FMF).
            Tare "TARE" "3.3.1" Setting with (Tare) answers [Ack] value ();
            /// Gripping statistics (grips, grips without part, lost parts), or one of them.
            Gripstats "GRIPSTATS" "3.3.2" Query with (Select<3>)
                answers [] value (Selected<GrippingStatistics, u32, 3>);
            /// Data of both fingers, or of one: a force in N from a WSG-FMF, a vector from a WSG-DSA.
            Fdata "FDATA" "3.4.1" Query with (Select<2>)
                answers [] value (Selected<[FingerReading<'a>; 2], FingerReading<'a>, 2>);
            /// Types of both fingers, or of one.
            Ftype "FTYPE" "3.4.2" Query with (Select<2>) answers [] value (Selected<[Text<'a>; 2], Text<'a>, 2>);
            /// State flags of both fingers, or of one; the first is bit 0.
            Fflags "FFLAGS" "3.4.3" Query with (Select<2>)
                answers [] value (Selected<[FingerFlags; 2], FingerFlags, 2>);
        }
    };
}
pub(super) use for_each_gcl_command;

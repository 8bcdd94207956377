//! The table of commands (GCL, chapters 2 and 3): the one place for names, sections, forms and answers.
//!
//! [`Request`](super::Request), [`Value`](super::Value) and [`CommandName`](super::CommandName) are made from it, and the
//! table in `docs/gcl.md`.

/// Calls the macro `$make` with every row of the table:
///
/// `Variant "NAME" "section" Kind unit Form | with (Parameters) answers [Ack, Fin] value (Type);`
///
/// What follows the name of a request is a [`Form`](super::form::Form): one that carries nothing (`unit`) or a type of
/// parameters (`with`). It is acknowledged, and finished later, or answered by a value.
macro_rules! for_each_gcl_command {
    ($make:ident) => {
        $make! {
            /// Has errors answered with a text beside the status code, or not.
            Verbose "VERBOSE" "2.1.1" Setting with (bool) answers [] value (bool);
            /// Announces the end of the connection, so that it causes no FAST STOP.
            Bye "BYE" "2.1.2" Connection unit Call answers [Ack] value ();

            /// References the fingers at an end stop.
            Home "HOME" "2.2.1" Motion with (HomingDirection) answers [Ack, Fin] value ();
            /// Moves the fingers to an opening width; a block is an error.
            Move "MOVE" "2.2.2" Motion with (Move) answers [Ack, Fin] value ();
            /// Grips a part.
            Grip "GRIP" "2.2.3" Motion with (Grip) answers [Ack, Fin] value ();
            /// Opens the fingers after a GRIP, by a distance.
            Release "RELEASE" "2.2.4" Motion with (Release) answers [Ack, Fin] value ();
            /// Part width tolerance in mm, of this connection: how much before the nominal width a part may be met.
            Pwt "PWT" "2.2.5" Setting with (Setting) answers [] value (f32);
            /// Clamping travel in mm, of this connection: how far a grip may go on to build up its force.
            Clt "CLT" "2.2.6" Setting with (Setting) answers [] value (f32);

            /// Opening width in mm.
            Pos "POS" "2.3.1" Query unit Ask answers [] value (f32);
            /// Speed of the fingers to each other in mm/s.
            Speed "SPEED" "2.3.2" Query unit Ask answers [] value (f32);
            /// Gripping force in N.
            Force "FORCE" "2.3.3" Query unit Ask answers [] value (f32);
            /// Gripper state.
            Gripstate "GRIPSTATE" "2.3.4" Query unit Ask answers [] value (GripperState);

            /// What device it is, such as `WSG 32-068`.
            Devtype "DEVTYPE" "3.1.1" Query unit Ask answers [] value (Text<'a>);
            /// Firmware version, such as `4.0.0`.
            Version "VERSION" "3.1.2" Query unit Ask answers [] value (Text<'a>);
            /// Serial number.
            Sn "SN" "3.1.3" Query unit Ask answers [] value (u32);
            /// Device tag. (The manual's example calls it `DEVTAG`; that is understood as well.)
            Tag "TAG" "3.1.4" Query unit Ask answers [] value (DeviceTag<'a>);
            /// System state flags, or one of them; D0 is the first.
            Sysflags "SYSFLAGS" "3.1.5" Query with (Select<32>) answers [] value (Selected<SystemFlags, bool, 32>);
            /// Temperature of the device in °C.
            Temp "TEMP" "3.1.6" Query unit Ask answers [] value (f32);
            /// Has a value sent by itself again and again, after an `@`, or ends that.
            Autosend "AUTOSEND" "3.1.7" Setting with (Autosend) answers [Ack] value ();

            /// Stops any finger movement; needs no acknowledgement.
            Stop "STOP" "3.2.1" Stop unit Call answers [Ack] value ();
            /// Stops any finger movement the fastest way and locks motion until FSACK.
            Faststop "FASTSTOP" "3.2.2" Stop unit Call answers [Ack] value ();
            /// Acknowledges a FAST STOP, which unlocks motion.
            Fsack "FSACK" "3.2.3" Acknowledge unit Call answers [Ack] value ();

            /// Zeroes force measurement fingers (WSG-FMF).
            Tare "TARE" "3.3.1" Setting with (Tare) answers [Ack] value ();
            /// Gripping statistics (grips, grips without part, parts lost), or one of them.
            Gripstats "GRIPSTATS" "3.3.2" Query with (Select<3>)
                answers [] value (Selected<GrippingStatistics, u32, 3>);
            /// Data of the fingers, or of one: a force in N from a WSG-FMF, a vector from a WSG-DSA.
            Fdata "FDATA" "3.4.1" Query with (Select<2>)
                answers [] value (Selected<[FingerReading<'a>; 2], FingerReading<'a>, 2>);
            /// Types of the fingers, or of one.
            Ftype "FTYPE" "3.4.2" Query with (Select<2>) answers [] value (Selected<[Text<'a>; 2], Text<'a>, 2>);
            /// State flags of the fingers, or of one; bit 0 is the first.
            Fflags "FFLAGS" "3.4.3" Query with (Select<2>)
                answers [] value (Selected<[FingerFlags; 2], FingerFlags, 2>);
        }
    };
}
pub(super) use for_each_gcl_command;

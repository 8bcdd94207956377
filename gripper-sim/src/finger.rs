//! Sensor fingers and their ports in the base jaws (command set, 3.6).

use wsg_protocol::{FingerFlags, FingerInfo, FingerType};

/// The finger mounted on a base jaw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Finger {
    /// No finger at the sensor port; Get Finger Info reports it as a generic one.
    #[default]
    None,
    /// A finger of unknown type with a switchable supply.
    Generic,
    /// WSG-FMF: measures the force on its jaw; its data frame is one `f32` in N.
    Fmf,
    /// WSG-DSA: a tactile sensor. The layout of its data frame is not public, so it provides no data here.
    Dsa,
}

impl Finger {
    /// All kinds of finger.
    pub const ALL: &'static [Self] = &[Self::None, Self::Generic, Self::Fmf, Self::Dsa];

    /// Returns the name used on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Generic => "generic",
            Self::Fmf => "fmf",
            Self::Dsa => "dsa",
        }
    }

    /// Returns whether Finger Power Control may switch the supply: only if no known type was detected.
    const fn is_switchable(self) -> bool {
        matches!(self, Self::None | Self::Generic)
    }
}

/// One of the two base jaws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Jaw {
    /// The jaw of finger 1 (commands 60h to 63h).
    One,
    /// The jaw of finger 2 (commands 70h to 73h).
    Two,
}

/// The sensor port of one jaw.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FingerPort {
    finger: Finger,
    powered: bool,
    /// Whether the configuration has been read since the supply was switched on.
    initialized: bool,
    short_circuit: bool,
    communication_fault: bool,
    /// Whether a script has opened the interface to custom electronics.
    interface_open: bool,
    /// Force in N on this jaw that reads as 0 N since Tare Force Sensor.
    tare: f64,
}

/// Result of a request to switch the supply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PowerOutcome {
    Off,
    StartingUp,
    Failed,
}

/// Why a finger provides no data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NoData {
    Unsupported,
    Communication,
}

impl FingerPort {
    pub(crate) const fn new(finger: Finger) -> Self {
        Self {
            finger,
            powered: true,
            initialized: true,
            short_circuit: false,
            communication_fault: false,
            interface_open: false,
            tare: 0.0,
        }
    }

    pub(crate) const fn kind(&self) -> Finger {
        self.finger
    }

    pub(crate) const fn info(&self) -> FingerInfo {
        match self.finger {
            Finger::None | Finger::Generic => FingerInfo { finger: FingerType::Generic, data_len: 0 },
            Finger::Fmf => FingerInfo { finger: FingerType::Fmf, data_len: size_of::<f32>() as u16 },
            Finger::Dsa => FingerInfo { finger: FingerType::Dsa, data_len: 0 },
        }
    }

    pub(crate) fn flags(&self) -> FingerFlags {
        let mut flags = FingerFlags::empty();
        let powered = self.is_powered();
        let is_known = powered && !self.finger.is_switchable();
        flags.set(FingerFlags::POWER_ON, powered);
        flags.set(FingerFlags::CONFIG_AVAIL, is_known && self.initialized);
        flags.set(FingerFlags::COMM_OPEN, self.communicates() || (powered && self.interface_open));
        flags.set(FingerFlags::POWER_FAULT, self.has_short_circuit());
        flags.set(FingerFlags::COMM_FAULT, is_known && self.initialized && self.communication_fault);
        flags.set(FingerFlags::INIT_FAULT, is_known && !self.initialized);
        flags
    }

    pub(crate) fn has_fault(&self) -> bool {
        const FAULTS: FingerFlags =
            FingerFlags::POWER_FAULT.union(FingerFlags::COMM_FAULT).union(FingerFlags::INIT_FAULT);
        self.flags().intersects(FAULTS)
    }

    /// Switches the supply on or off.
    pub(crate) fn switch(&mut self, on: bool) -> PowerOutcome {
        if !self.finger.is_switchable() || (on && self.has_short_circuit()) {
            return PowerOutcome::Failed;
        }
        self.powered = on;
        if on { PowerOutcome::StartingUp } else { PowerOutcome::Off }
    }

    pub(crate) fn set_short_circuit(&mut self, on: bool) {
        self.short_circuit = on;
        // The supply of a switchable finger stays off until a client switches it on again.
        if self.has_short_circuit() && self.finger.is_switchable() {
            self.powered = false;
        }
        self.initialize();
    }

    pub(crate) const fn set_communication_fault(&mut self, on: bool) {
        self.communication_fault = on;
        self.initialize();
    }

    /// Opens or closes the interface to custom electronics. The gripper itself uses that of a finger of a known type.
    pub(crate) const fn set_interface(&mut self, open: bool) {
        self.interface_open = open && self.finger.is_switchable();
    }

    /// Tries to read the configuration, which fails without supply or with a communication fault. The finger retries
    /// until it succeeds; later faults do not affect the initialization (GCL, appendix C).
    const fn initialize(&mut self) {
        self.initialized = self.is_powered() && (self.initialized || !self.communication_fault);
    }

    /// Returns whether the finger is a working force sensor.
    pub(crate) fn measures_force(&self) -> bool {
        matches!(self.finger, Finger::Fmf) && self.communicates()
    }

    /// Returns whether a force sensor is mounted, working or not.
    pub(crate) const fn is_force_sensor(&self) -> bool {
        matches!(self.finger, Finger::Fmf)
    }

    /// Tares the sensor: `force`, in N on this jaw, reads as 0 N from now on.
    pub(crate) const fn zero_at(&mut self, force: f64) {
        self.tare = force;
    }

    /// Returns the reading for `force`, in N on this jaw.
    pub(crate) fn measured(&self, force: f64) -> f64 {
        force - self.tare
    }

    /// Returns the data frame while `force`, in N, acts on this jaw.
    pub(crate) fn data(&self, force: f64) -> Result<[u8; 4], NoData> {
        match self.finger {
            Finger::Fmf if self.communicates() => Ok((self.measured(force) as f32).to_le_bytes()),
            Finger::Fmf => Err(NoData::Communication),
            Finger::None | Finger::Generic | Finger::Dsa => Err(NoData::Unsupported),
        }
    }

    const fn is_powered(&self) -> bool {
        self.powered && !self.has_short_circuit()
    }

    /// Returns whether the supply is shorted. An empty port cannot be.
    const fn has_short_circuit(&self) -> bool {
        self.short_circuit && !matches!(self.finger, Finger::None)
    }

    const fn communicates(&self) -> bool {
        self.is_powered() && self.initialized && !self.communication_fault && !self.finger.is_switchable()
    }
}

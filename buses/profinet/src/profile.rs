//! What is fixed about a device.

/// What is fixed about a device: what it is, what is in its slots, and which faults it may tell of.
#[derive(Debug)]
pub struct Profile {
    /// The number of the vendor, from PROFIBUS & PROFINET International.
    pub vendor_id: u16,
    /// The number of the device among those of its vendor.
    pub device_id: u16,
    /// What the vendor calls the device, up to 25 characters.
    pub station_type: &'static str,
    /// What it is ordered by, up to 20 characters.
    pub order_id: &'static str,
    /// Its serial number, up to 16 characters.
    pub serial_number: &'static str,
    /// The revision of the hardware.
    pub hardware_revision: u16,
    /// The revision of the software: functional enhancement, bug fix, internal change. It is a released one (`V`).
    pub software_revision: [u8; 3],
    /// The shortest cycle, in 31.25 µs; a power of two from 32 (1 ms).
    pub min_interval: u16,
    /// What is in the slots. Slot 0 is the device access point, with its interface (8000h) and its port (8001h).
    pub modules: &'static [Module],
    /// The faults that the device may tell of: bit n of what it shows is entry n. Up to 32.
    pub faults: &'static [Fault],
}

/// What is in a slot for good.
#[derive(Debug)]
pub struct Module {
    /// The number of the slot.
    pub slot: u16,
    /// The ident number of the module.
    pub ident: u32,
    /// What it is called in configuration tools.
    pub name: &'static str,
    /// What it consists of.
    pub submodules: &'static [Submodule],
}

/// What carries data.
#[derive(Debug)]
pub struct Submodule {
    /// The number of the subslot.
    pub subslot: u16,
    /// The ident number of the submodule.
    pub ident: u32,
    /// Bytes from the device to the controller.
    pub input_len: u16,
    /// Bytes from the controller to the device.
    pub output_len: u16,
}

/// A fault that a device may tell of: channel diagnosis of the whole device access point.
#[derive(Debug)]
pub struct Fault {
    /// ChannelErrorType; 0100h to 7FFFh are the vendor's.
    pub error_type: u16,
    /// What it is called in configuration tools.
    pub name: &'static str,
    /// Which alarm tells of it.
    pub priority: Priority,
}

/// The priority of an alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Priority {
    /// As is usual for diagnosis.
    Low,
    /// Before all of low priority.
    High,
}

/// How many submodules a device may have, and how many a controller may expect.
pub const MAX_SUBMODULES: usize = 16;

/// A submodule with its place: its module, and where its data is in those of the device.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slotted {
    pub(crate) module: &'static Module,
    pub(crate) submodule: &'static Submodule,
    pub(crate) input_at: usize,
    pub(crate) output_at: usize,
}

impl Submodule {
    /// Returns how many bytes it takes of a frame of inputs and of a frame of outputs: its data, each with the status of the
    /// provider, and the status of the consumer of data in the other direction. A submodule without data counts as inputs.
    pub(crate) const fn frame_lens(&self) -> (u16, u16) {
        let Self { input_len, output_len, .. } = *self;
        let has_outputs = output_len > 0;
        let has_inputs = input_len > 0 || !has_outputs;
        let (provided, consumed) = (has_inputs as u16, has_outputs as u16);
        let inputs = input_len.saturating_add(provided).saturating_add(consumed);
        let outputs = output_len.saturating_add(consumed).saturating_add(provided);
        (inputs, outputs)
    }
}

impl Profile {
    /// Every submodule, in the order of the tables.
    pub(crate) fn submodules(&self) -> impl Iterator<Item = Slotted> + use<> {
        let mut places = (0_usize, 0_usize);
        let pairs = self
            .modules
            .iter()
            .flat_map(|module| module.submodules.iter().map(move |submodule| (module, submodule)));
        pairs.map(move |(module, submodule)| {
            let (input_at, output_at) = places;
            places = (
                input_at.saturating_add(submodule.input_len.into()),
                output_at.saturating_add(submodule.output_len.into()),
            );
            Slotted { module, submodule, input_at, output_at }
        })
    }

    pub(crate) fn module(&self, slot: u16) -> Option<&'static Module> {
        self.modules.iter().find(|module| module.slot == slot)
    }

    pub(crate) fn submodule(&self, slot: u16, subslot: u16) -> Option<&'static Submodule> {
        self.module(slot)?.submodules.iter().find(|submodule| submodule.subslot == subslot)
    }

    /// Whether it is one that a device can have with so many bytes of data; for a `const` assertion.
    #[must_use]
    pub const fn fits(&self, output_len: usize, input_len: usize) -> bool {
        let (mut inputs, mut outputs, mut count, mut module) = (0, 0, 0_usize, 0);
        while module < self.modules.len() {
            let Some((_, modules)) = self.modules.split_at_checked(module) else { return false };
            let Some((here, _)) = modules.split_first() else { return false };
            let mut rest = here.submodules;
            while let Some((submodule, others)) = rest.split_first() {
                inputs = submodule.input_len.saturating_add(inputs);
                outputs = submodule.output_len.saturating_add(outputs);
                count = count.saturating_add(1);
                rest = others;
            }
            module = module.saturating_add(1);
        }
        inputs as usize == input_len
            && outputs as usize == output_len
            && count <= MAX_SUBMODULES
            && self.faults.len() <= 32
            && self.station_type.len() <= 25
            && self.order_id.len() <= 20
            && self.serial_number.len() <= 16
            && self.min_interval.is_power_of_two()
            && self.min_interval >= 32
    }
}

#[cfg(test)]
mod tests;

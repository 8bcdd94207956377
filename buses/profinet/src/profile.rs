//! Fixed properties of a device.

/// Fixed properties of a device: identity, slots and reportable faults.
#[derive(Debug)]
pub struct Profile {
    /// Vendor number, assigned by PROFIBUS & PROFINET International.
    pub vendor_id: u16,
    /// Device number, assigned by the vendor.
    pub device_id: u16,
    /// Device name by the vendor, up to 25 characters.
    pub station_type: &'static str,
    /// Order number, up to 20 characters.
    pub order_id: &'static str,
    /// Serial number, up to 16 characters.
    pub serial_number: &'static str,
    /// Revision of the hardware.
    pub hardware_revision: u16,
    /// Revision of the software: functional enhancement, bug fix, internal change. Reported as released (`V`).
    pub software_revision: [u8; 3],
    /// Minimum cycle time in 31.25 µs; a power of two from 32 (1 ms).
    pub min_interval: u16,
    /// Contents of the slots. Slot 0 is the device access point, with its interface (8000h) and its port (8001h).
    pub modules: &'static [Module],
    /// Reportable faults, up to 32. Bit n of [`show_faults`](crate::Device::show_faults) is entry n.
    pub faults: &'static [Fault],
}

/// A module, permanently present in its slot.
#[derive(Debug)]
pub struct Module {
    /// Number of the slot.
    pub slot: u16,
    /// Ident number of the module.
    pub ident: u32,
    /// Name in configuration tools.
    pub name: &'static str,
    /// Submodules of the module.
    pub submodules: &'static [Submodule],
}

/// A submodule, which carries data.
#[derive(Debug)]
pub struct Submodule {
    /// Number of the subslot.
    pub subslot: u16,
    /// Ident number of the submodule.
    pub ident: u32,
    /// Number of bytes from the device to the controller.
    pub input_len: u16,
    /// Number of bytes from the controller to the device.
    pub output_len: u16,
}

/// A reportable fault: channel diagnosis of the whole device access point.
#[derive(Debug)]
pub struct Fault {
    /// ChannelErrorType; 0100h to 7FFFh are vendor-specific.
    pub error_type: u16,
    /// Name in configuration tools.
    pub name: &'static str,
    /// Priority of the alarm that reports it.
    pub priority: Priority,
}

/// Priority of an alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Priority {
    /// Low priority, usual for diagnosis.
    Low,
    /// High priority, sent before all low-priority alarms.
    High,
}

/// Maximum number of submodules of a device, and of those that a controller may expect.
pub const MAX_SUBMODULES: usize = 16;

/// A submodule with its module and its offsets in the device's inputs and outputs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slotted {
    pub(crate) module: &'static Module,
    pub(crate) submodule: &'static Submodule,
    pub(crate) input_at: usize,
    pub(crate) output_at: usize,
}

impl Submodule {
    /// Returns the number of bytes it occupies in a frame of inputs and in a frame of outputs: its data with provider
    /// status, and the consumer status of data in the other direction. A submodule without data counts as inputs.
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
    /// Iterates over all submodules in the order of the tables.
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

    /// Returns whether the profile is valid for this number of data bytes. Intended for a `const` assertion.
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

//! The functions of an image and their calls.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context, Result, ensure};
use object::{Object, ObjectSection, ObjectSymbol, SectionKind, SymbolKind, read::elf::ElfFile32};

use super::thumb::{Effect, decode};

/// A function, identified by its first address.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Function {
    pub(super) name: String,
    /// Stack frame in bytes: the total of all pushes in the code. `None` if the code sets the stack pointer in another way.
    pub(super) frame: Option<u64>,
    /// Functions that it calls or jumps to.
    pub(super) calls: BTreeSet<u32>,
    /// Whether it has indirect calls.
    pub(super) is_indirect: bool,
}

/// The functions of a Cortex-M image and their calls.
#[derive(Debug, Default)]
pub struct Program {
    pub(super) functions: BTreeMap<u32, Function>,
    /// Functions whose address is stored in data or built in code.
    pub(super) taken: BTreeSet<u32>,
    /// Address of the reset handler.
    pub(super) reset: u32,
    /// Handlers of exceptions and interrupts.
    pub(super) handlers: BTreeSet<u32>,
}

/// The code, including embedded data.
struct Code<'a> {
    /// Address and bytes of the sections with code or data, because functions may be placed in RAM.
    sections: Vec<(u32, &'a [u8])>,
    /// Boundaries of data within the code.
    data: BTreeMap<u32, bool>,
}

impl Program {
    /// Reads an ELF file with symbols.
    ///
    /// # Errors
    /// Fails when it is not a 32-bit ELF file, has no function symbols or no `.vector_table`, or lacks the code of a function.
    pub fn of(elf: &[u8]) -> Result<Self> {
        let elf = ElfFile32::<object::Endianness>::parse(elf)?;
        let mut program = Self::default();
        let code = Code::of(&elf)?;
        let starts = starts_of(&elf);
        ensure!(!starts.is_empty(), "no function symbols");
        for (&start, (name, size)) in &starts {
            let section_end = code.end(start).with_context(|| format!("no code of {name} at {start:#x}"))?;
            let next = starts.range(start + 1..section_end).next().map_or(section_end, |(next, _)| *next);
            // Some assembly functions have no size. After other functions there may be padding.
            let end = if *size == 0 { next } else { next.min(start + size) };
            let function = code.function(name.clone(), start..end, &mut program.taken);
            program.functions.insert(start, function);
        }
        // A call's target is the function that contains the address, so jumps within a function are no calls.
        let holders: Vec<u32> = program.functions.keys().copied().collect();
        for (start, function) in &mut program.functions {
            let of = |address: u32| {
                holders.partition_point(|it| *it <= address).checked_sub(1).map(|at| holders[at])
            };
            let calls = std::mem::take(&mut function.calls);
            let is_recursion = |address: &u32| *address == *start;
            function.calls = calls
                .into_iter()
                .filter_map(|address| of(address).filter(|it| it != start || is_recursion(&address)))
                .collect();
        }
        program.taken.extend(words_of_data(&elf)?);
        program.read_vectors(&elf)?;
        let functions = &program.functions;
        program.taken.retain(|address| functions.contains_key(address));
        Ok(program)
    }

    /// Reads the vector table: initial stack pointer, Reset, then the handlers.
    fn read_vectors(&mut self, elf: &ElfFile32<'_>) -> Result<()> {
        let vectors = elf.section_by_name(".vector_table").context("no section .vector_table")?;
        let mut words = words(vectors.data()?).skip(1);
        self.reset = words.next().context("the vector table is empty")? & !1;
        self.handlers = words.filter(|word| *word != 0).map(|word| word & !1).collect();
        Ok(())
    }
}

impl<'a> Code<'a> {
    fn of(elf: &ElfFile32<'a>) -> Result<Self> {
        let holds_code = |kind| matches!(kind, SectionKind::Text | SectionKind::Data);
        let sections = elf.sections().filter(|section| holds_code(section.kind()));
        let sections = sections.map(|section| Ok((section.address() as u32, section.data()?)));
        let mut data = BTreeMap::new();
        for symbol in elf.symbols() {
            // Mapping symbols (ELF for the Arm Architecture, 5.5.5): $t before code, $d before data.
            match symbol.name().unwrap_or_default() {
                "$d" => data.insert(symbol.address() as u32, true),
                "$t" => data.insert(symbol.address() as u32, false),
                _ => None,
            };
        }
        Ok(Self { sections: sections.collect::<Result<_>>()?, data })
    }

    /// Returns the end of the section that contains the address.
    fn end(&self, address: u32) -> Option<u32> {
        let mut ranges = self.sections.iter().map(|(start, bytes)| *start..start + bytes.len() as u32);
        ranges.find(|range| range.contains(&address)).map(|range| range.end)
    }

    fn is_data(&self, address: u32) -> bool {
        self.data.range(..=address).next_back().is_some_and(|(_, is_data)| *is_data)
    }

    fn halfword(&self, address: u32) -> Option<u16> {
        self.sections.iter().find_map(|(start, bytes)| {
            let at = address.checked_sub(*start)? as usize;
            Some(u16::from_le_bytes(bytes.get(at..at + 2)?.try_into().ok()?))
        })
    }

    /// Decodes the code of a function; addresses that it builds or contains are added to `taken`.
    fn function(&self, name: String, range: std::ops::Range<u32>, taken: &mut BTreeSet<u32>) -> Function {
        let mut function = Function { name, frame: Some(0), ..Function::default() };
        let mut low_halves = [0_u16; 16];
        let mut address = range.start;
        while address < range.end {
            let Some(first) = self.halfword(address) else { break };
            let second = self.halfword(address + 2).unwrap_or(0);
            if self.is_data(address) {
                let word = u32::from(second) << 16 | u32::from(first);
                // The linker's thunk continues at the address that it contains, such as that of a function in RAM.
                let is_thunk = function.name.starts_with("__Thumb");
                let found = if is_thunk { &mut function.calls } else { &mut *taken };
                found.extend((word & 1 == 1).then_some(word & !1));
                address += 2;
                continue;
            }
            let (length, effect) = decode(address, [first, second]);
            match effect {
                Effect::Call(to) => {
                    function.calls.insert(to);
                }
                Effect::Jump(to) if !range.contains(&to) => {
                    function.calls.insert(to);
                }
                Effect::IndirectCall => function.is_indirect = true,
                Effect::Push(bytes) => function.frame = function.frame.map(|it| it + u64::from(bytes)),
                Effect::SetStack => function.frame = None,
                Effect::Half { register, high: false, value } => {
                    low_halves[usize::from(register & 0xF)] = value;
                }
                Effect::Half { register, high: true, value } => {
                    let low = low_halves[usize::from(register & 0xF)];
                    let made = u32::from(value) << 16 | u32::from(low);
                    taken.extend((made & 1 == 1).then_some(made & !1));
                }
                Effect::Jump(_) | Effect::Other => {}
            }
            address += length;
        }
        function
    }
}

/// Returns each function's first address, name and size.
fn starts_of(elf: &ElfFile32<'_>) -> BTreeMap<u32, (String, u32)> {
    let mut starts = BTreeMap::new();
    for symbol in elf.symbols().filter(|symbol| symbol.kind() == SymbolKind::Text) {
        let name = symbol.name().unwrap_or_default();
        if symbol.is_definition() && !name.is_empty() && !name.starts_with('$') {
            let start = symbol.address() as u32 & !1;
            starts.entry(start).or_insert_with(|| (readable(name), symbol.size() as u32));
        }
    }
    starts
}

/// Demangles a name, without its hash.
fn readable(mangled: &str) -> String {
    format!("{:#}", rustc_demangle::demangle(mangled))
}

/// Returns words in data that may be function addresses.
fn words_of_data(elf: &ElfFile32<'_>) -> Result<BTreeSet<u32>> {
    let mut found = BTreeSet::new();
    for section in elf.sections() {
        if matches!(section.kind(), SectionKind::ReadOnlyData | SectionKind::Data)
            && section.name()? != ".vector_table"
        {
            found.extend(words(section.data()?).filter(|word| word & 1 == 1).map(|word| word & !1));
        }
    }
    Ok(found)
}

fn words(bytes: &[u8]) -> impl Iterator<Item = u32> {
    bytes.chunks_exact(4).map(|word| u32::from_le_bytes(word.try_into().unwrap_or_default()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn follow(name: &str, code: &[u16], range: std::ops::Range<u32>) -> (Function, BTreeSet<u32>) {
        let bytes: Vec<u8> = code.iter().flat_map(|it| it.to_le_bytes()).collect();
        let code = Code { sections: vec![(0x100, &bytes)], data: BTreeMap::from([(0x10C, true)]) };
        let mut taken = BTreeSet::new();
        (code.function(name.into(), range, &mut taken), taken)
    }

    #[test]
    fn pushes_calls_and_addresses_in_a_function_are_seen() {
        // push {r7, lr}; sub sp, #56; bl 0x200; blx r3; followed by a word that resembles an address
        let code = [0xB580, 0xB08E, 0xF000, 0xF87C, 0x4798, 0xBF00, 0x0301, 0x0000];

        let (function, taken) = follow("f", &code, 0x100..0x110);

        assert_eq!((function.frame, function.is_indirect), (Some(64), true));
        assert_eq!(function.calls, BTreeSet::from([0x200]));
        assert_eq!(taken, BTreeSet::from([0x300]));
    }

    #[test]
    fn a_function_that_sets_the_stack_pointer_has_no_known_frame() {
        // push {r7, lr}; add sp, r6; push {r7, lr}
        let (function, _) = follow("f", &[0xB580, 0x44B5, 0xB580], 0x100..0x106);

        assert_eq!(function.frame, None);
    }

    #[test]
    fn a_thunk_continues_at_the_address_that_it_contains() {
        // push {r0, r1}; ldr r0, [pc]; str r0, [sp, #4]; pop {r0, pc}; alignment; the address
        let code = [0xB403, 0x4801, 0x9001, 0xBD01, 0xBF00, 0xBF00, 0x0301, 0x2000];

        let (thunk, taken) = follow("__Thumbv6MABSLongThunk_f", &code, 0x100..0x110);

        assert_eq!((thunk.calls, taken), (BTreeSet::from([0x2000_0300]), BTreeSet::new()));
    }

    #[test]
    fn names_are_readable() {
        assert_eq!(readable("_ZN5frame6parser4push17h0123456789abcdefE"), "frame::parser::push");
        assert_eq!(readable("Reset"), "Reset");
    }
}

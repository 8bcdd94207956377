//! Rows of the register tables. Each row has its register number and its accessor, so that any module can contribute rows.

/// A setting in a holding register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setting {
    /// Name in documents and tools.
    pub name: &'static str,
    /// Unit; empty for a plain number.
    pub unit: &'static str,
    /// Least value that a write may have; lower ones are refused.
    pub least: u16,
    /// Greatest value that a write may have; higher ones are refused.
    pub most: u16,
    /// Effect of the value, short enough for a table cell.
    pub meaning: &'static str,
}

/// A report on the bridge in an input register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// Name in documents and tools.
    pub name: &'static str,
    /// Reported value, short enough for a table cell.
    pub meaning: &'static str,
}

/// Rows of a table, each with its register number.
pub(crate) type Rows<T> = &'static [(u16, T)];

/// Defines the settings of a configuration. A row has register, name, unit, range and meaning, followed by the field and the
/// conversions to and from a register. The latter returns `None` for an invalid value. The default is that of the
/// configuration. An optional last line is a condition across settings, with the register to report if it is not met.
macro_rules! setting_rows {
    ($config:ty: $(
        $register:literal $name:literal $unit:literal ($least:expr, $most:expr) $meaning:tt
        $($field:ident).+: |$is:ident| $read:expr, |$value:ident| $write:expr;
    )* $(together $cause:literal: |$all:ident| $fits:expr;)?) => {
        impl $config {
            pub(crate) const SETTINGS: $crate::register::Rows<$crate::register::Setting> = &[$(($register, $crate::register::Setting {
                name: $name,
                unit: $unit,
                least: $least,
                most: $most,
                meaning: $meaning,
            })),*];

            /// Writes the settings to a record.
            #[allow(clippy::indexing_slicing, reason = "a row outside of the record does not compile")]
            pub(crate) const fn put<const LEN: usize>(&self, record: &mut [u16; LEN]) {
                $(record[const { $crate::register::place_in::<LEN>($register) }] = {
                    let $is = self.$($field).+;
                    $read
                };)*
            }

            /// Reads the settings from the values, by index. Fails with the register of the first invalid value.
            pub(crate) fn take(&mut self, value_at: &impl Fn(usize) -> u16) -> Result<(), u16> {
                $({
                    let $value = value_at(($register - $crate::register::FIRST_SETTING) as usize);
                    let Some(value) = $write else { return Err($register) };
                    self.$($field).+ = value;
                })*
                $(
                    let $all = &*self;
                    if !$fits {
                        return Err($cause);
                    }
                )?
                Ok(())
            }

            /// Checks these settings, which are in their ranges, for conflicts.
            #[allow(dead_code, reason = "only the settings of PLC sides are checked separately")]
            pub(crate) fn check(value_at: &impl Fn(usize) -> u16) -> Result<(), u16> {
                let mut config = Self::DEFAULT;
                config.take(value_at)
            }
        }
    };
}

/// Defines the reports of a type. A row has register, name, meaning and the register's value.
macro_rules! report_rows {
    ($source:ty as $it:ident: $($register:literal $name:literal $meaning:tt $value:expr;)*) => {
        impl $source {
            pub(crate) const REPORTS: $crate::register::Rows<$crate::register::Report> =
                &[$(($register, $crate::register::Report { name: $name, meaning: $meaning })),*];

            /// Returns the report in a register, or `None` if this type does not have the register.
            pub(crate) fn value_of(&self, register: u16) -> Option<u16> {
                let $it = self;
                Some(match register {
                    $($register => $value,)*
                    _ => return None,
                })
            }
        }
    };
}

pub(crate) use {report_rows, setting_rows};

/// Returns the index of a setting in a record of this length.
pub(crate) const fn place_in<const LEN: usize>(register: u16) -> usize {
    let place = (register - super::FIRST_SETTING) as usize;
    assert!(place < LEN, "no setting has this register");
    place
}

/// Returns the number of rows in all parts.
pub(crate) const fn count<T: Copy>(parts: &[Rows<T>]) -> usize {
    let (mut count, mut part) = (0, 0);
    while part < parts.len() {
        #[expect(clippy::indexing_slicing, reason = "below the length, at compile time")]
        let rows = parts[part];
        count += rows.len();
        part += 1;
    }
    count
}

/// Assembles a table that starts at register `first`. Evaluated at compile time, where a missing or duplicate register is an
/// error.
pub(crate) const fn assembled<T: Copy, const LEN: usize>(first: u16, parts: &[Rows<T>]) -> [T; LEN] {
    #[expect(clippy::indexing_slicing, reason = "at compile time, where a wrong index does not compile")]
    {
        let mut table = [parts[0][0].1; LEN];
        let mut is_there = [false; LEN];
        let mut part = 0;
        while part < parts.len() {
            let mut row = 0;
            while row < parts[part].len() {
                let (register, entry) = parts[part][row];
                let place = (register - first) as usize;
                assert!(!is_there[place], "two rows have the same register");
                (table[place], is_there[place]) = (entry, true);
                row += 1;
            }
            part += 1;
        }
        assert!(count(parts) == LEN, "a register has no row");
        table
    }
}

/// Converts a value to a register, saturating at 65 535.
pub(crate) const fn saturate(value: u32) -> u16 {
    if value > u16::MAX as u32 { u16::MAX } else { value as u16 }
}

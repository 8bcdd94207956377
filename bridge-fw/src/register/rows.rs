//! Rows of the register tables: each with its number and its accessor, so that every table can be assembled from parts.

/// A holding register that holds a setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setting {
    /// Its name.
    pub name: &'static str,
    /// Its unit; empty for a number without one.
    pub unit: &'static str,
    /// The least value it takes.
    pub least: u16,
    /// The greatest value it takes.
    pub most: u16,
    /// What it is for.
    pub meaning: &'static str,
}

/// An input register that reports on the bridge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// Its name.
    pub name: &'static str,
    /// What it says.
    pub meaning: &'static str,
}

/// Rows of a table, each with its register.
pub(crate) type Rows<T> = &'static [(u16, T)];

/// Defines the settings of a configuration. A row has register, name, unit, range and meaning, then the field, the conversion to
/// a register, and the conversion from one: `None` for a value that no bridge can use. The default is that of the configuration.
/// An optional last line is a condition over all settings, with the register to report when it is not met.
macro_rules! setting_rows {
    ($config:ty: $(
        $register:literal $name:literal $unit:literal ($least:expr, $most:expr) $meaning:tt
        $($field:ident).+: |$is:ident| $read:expr, |$value:ident| $write:expr;
    )* $(together $culprit:literal: |$all:ident| $fits:expr;)?) => {
        impl $config {
            /// The rows of its settings.
            pub(crate) const SETTINGS: $crate::register::Rows<$crate::register::Setting> = &[$(($register, $crate::register::Setting {
                name: $name,
                unit: $unit,
                least: $least,
                most: $most,
                meaning: $meaning,
            })),*];

            /// Writes its settings to a record.
            #[allow(clippy::indexing_slicing, reason = "a row outside of the record does not compile")]
            pub(crate) const fn put<const LEN: usize>(&self, record: &mut [u16; LEN]) {
                $(record[const { $crate::register::place_in::<LEN>($register) }] = {
                    let $is = self.$($field).+;
                    $read
                };)*
            }

            /// Takes its settings from the values at their places. Fails with the register whose value no bridge can have.
            pub(crate) fn take(&mut self, value_at: &impl Fn(usize) -> u16) -> Result<(), u16> {
                $({
                    let $value = value_at(($register - $crate::register::FIRST_SETTING) as usize);
                    let Some(value) = $write else { return Err($register) };
                    self.$($field).+ = value;
                })*
                $(
                    let $all = &*self;
                    if !$fits {
                        return Err($culprit);
                    }
                )?
                Ok(())
            }

            /// Returns whether a bridge can have these settings, which are in their ranges.
            #[allow(dead_code, reason = "only those of PLC sides are checked by themselves")]
            pub(crate) fn check(value_at: &impl Fn(usize) -> u16) -> Result<(), u16> {
                let mut config = Self::DEFAULT;
                config.take(value_at)
            }
        }
    };
}

/// Defines the reports that a value makes. A row has register, name, meaning and the register's value.
macro_rules! report_rows {
    ($source:ty as $it:ident: $($register:literal $name:literal $meaning:literal $value:expr;)*) => {
        impl $source {
            /// The rows of its reports.
            pub(crate) const REPORTS: $crate::register::Rows<$crate::register::Report> =
                &[$(($register, $crate::register::Report { name: $name, meaning: $meaning })),*];

            /// Returns the report in a register, or `None` if it is not one of these.
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

/// The place of a setting in a record of this length.
pub(crate) const fn place_in<const LEN: usize>(register: u16) -> usize {
    let place = (register - super::FIRST_SETTING) as usize;
    assert!(place < LEN, "no setting has this register");
    place
}

/// Returns how many rows these parts have.
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

/// Returns the table that consists of these parts, from register `first` on. At compile time, where a register that is missing or
/// there twice does not compile.
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

/// Returns a value as a register holds it, or the register's greatest.
pub(crate) const fn saturate(value: u32) -> u16 {
    if value > u16::MAX as u32 { u16::MAX } else { value as u16 }
}

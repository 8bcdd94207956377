//! The gateway's reports on itself, in input registers that the bridge does not have.

use std::collections::VecDeque;
use std::net::{IpAddr, Ipv6Addr};
use std::time::Duration;

use bus_modbus::MAX_PDU_LEN;

/// Address of the first report, an input register. The bridge's registers end before it.
pub(crate) const FIRST: u16 = 1_000;

/// Number of intervals between two writes from which cycle time and jitter are calculated.
const INTERVALS: usize = 64;

/// Number of registers of an address. All other reports are shorter, and numbers.
const ADDRESS_LEN: usize = 8;

/// A report, in consecutive registers with the highest word first.
#[cfg_attr(not(feature = "telemetry"), allow(dead_code, reason = "only telemetry shows all fields"))]
pub(crate) struct Report {
    /// Name in documents and tools.
    pub(crate) name: &'static str,
    /// Name of the metric in `wsg telemetry`.
    pub(crate) metric: &'static str,
    /// Unit; empty for a plain number and an address.
    pub(crate) unit: &'static str,
    /// Reported value, short enough for a table cell.
    pub(crate) meaning: &'static str,
    registers: usize,
    value: fn(&Measured) -> u128,
}

/// Defines the reports. A row has the number of registers, name, metric, unit, meaning, and the value.
macro_rules! reports {
    ($it:ident: $($registers:literal $name:literal $metric:literal $unit:literal $meaning:literal $value:expr;)*) => {
        /// The reports, in the order of their registers.
        pub(crate) const REPORTS: &[Report] = &[$(Report {
            name: $name,
            metric: $metric,
            unit: $unit,
            meaning: $meaning,
            registers: $registers,
            value: |$it| $value,
        }),*];
    };
}

reports! { it:
    1 "MASTERS" "Gateway/Masters" "" "connected Modbus/TCP masters of the port, including the reader" it.masters as u128;
    2 "MASTER_CONNECTIONS" "Gateway/Master Connections" "" "Modbus/TCP connections to the port since the start"
        it.master_connections.into();
    8 "PLC_ADDRESS" "Gateway/PLC Address" "" "IP address of the PLC, the master that wrote last, until it is silent; 0.0.0.0: a PROFINET controller"
        it.plc.as_ref().map_or(0, |plc| bits(plc.address));
    2 "CYCLE_TIME" "Gateway/Cycle Time" "µs" "mean of the last intervals between two writes of this PLC, up to 64; 0: unknown"
        it.plc.as_ref().map_or(0, Plc::cycle);
    2 "JITTER" "Gateway/Jitter" "µs" "largest deviation of these intervals from their mean"
        it.plc.as_ref().map_or(0, Plc::jitter);
    1 "MISSED_CYCLES" "Gateway/Missed Cycles" "" "intervals longer than twice the mean of the 64 intervals before, since the start"
        it.missed_cycles.into();
    1 "GRIPPER_CONNECTIONS" "Gateway/Gripper Connections" "" "connections to the gripper since the start"
        it.gripper_connections.into();
    1 "PAUSES" "Gateway/Pauses" "" "pauses of the computer for more than 0.8 s since the start" it.pauses.into();
    1 "LONGEST_PAUSE" "Gateway/Longest Pause" "ms" "longest time for which the computer did not run the gateway, since the start"
        it.longest_pause.as_millis();
}

/// Number of registers of all reports.
pub(crate) const LEN: u16 = {
    let (mut len, mut at) = (0, 0);
    while at < REPORTS.len() {
        len += REPORTS[at].registers as u16;
        at += 1;
    }
    len
};

/// A value of a report.
pub(crate) enum Reported {
    Number(u64),
    Address(Option<IpAddr>),
}

impl Report {
    /// Returns whether the value is an address.
    pub(crate) const fn is_address(&self) -> bool {
        self.registers == ADDRESS_LEN
    }
}

/// Returns the reports in all [`LEN`] registers.
pub(crate) fn reported(registers: &[u16]) -> impl Iterator<Item = (&'static Report, Reported)> {
    let mut rest = registers.iter();
    REPORTS.iter().map(move |report| {
        let words = rest.by_ref().take(report.registers);
        let value = words.fold(0, |value, word| value << 16 | u128::from(*word));
        let reported = if report.is_address() {
            Reported::Address((value != 0).then(|| Ipv6Addr::from_bits(value).to_canonical()))
        } else {
            Reported::Number(value as u64)
        };
        (report, reported)
    })
}

/// What a gateway measures for its reports.
#[derive(Debug, Default)]
pub(crate) struct Measured {
    /// This and the next field are set before the reports are read.
    pub(crate) masters: usize,
    pub(crate) master_connections: u32,
    pub(crate) pauses: u32,
    pub(crate) gripper_connections: u32,
    pub(crate) longest_pause: Duration,
    plc: Option<Plc>,
    missed_cycles: u32,
}

#[derive(Debug)]
struct Plc {
    address: IpAddr,
    wrote_at: Duration,
    /// The latest intervals between two writes, in µs.
    intervals: VecDeque<u128>,
}

impl Plc {
    /// Returns the mean of the intervals.
    fn cycle(&self) -> u128 {
        self.intervals.iter().sum::<u128>().checked_div(self.intervals.len() as u128).unwrap_or(0)
    }

    fn jitter(&self) -> u128 {
        let mean = self.cycle();
        self.intervals.iter().map(|interval| interval.abs_diff(mean)).max().unwrap_or(0)
    }
}

impl Measured {
    /// Records an output image that the PLC at this address has written. Another PLC begins without intervals.
    pub(crate) fn note_cycle(&mut self, address: IpAddr, now: Duration) {
        let Some(plc) = self.plc.as_mut().filter(|plc| plc.address == address) else {
            self.plc = Some(Plc { address, wrote_at: now, intervals: VecDeque::new() });
            return;
        };
        let interval = now.saturating_sub(plc.wrote_at).as_micros();
        plc.wrote_at = now;
        if plc.intervals.len() == INTERVALS {
            if interval > 2 * plc.cycle() {
                self.missed_cycles = self.missed_cycles.saturating_add(1);
            }
            plc.intervals.pop_front();
        }
        plc.intervals.push_back(interval);
    }

    /// Forgets the PLC, which is silent.
    pub(crate) fn lose_plc(&mut self) {
        self.plc = None;
    }

    /// Answers a request for reports. The bridge has rejected it, because it does not have these registers. Returns the length of
    /// the response, or `None` for any other request.
    pub(crate) fn answer(&self, request: &[u8], response: &mut [u8; MAX_PDU_LEN]) -> Option<usize> {
        let ([4, a1, a0, q1, q0], [0x84, 2, ..]) = (request, &*response) else { return None };
        let first = usize::from(u16::from_be_bytes([*a1, *a0]).checked_sub(FIRST)?);
        let count = usize::from(u16::from_be_bytes([*q1, *q0]));
        let registers = self.registers();
        let registers = registers.get(first..first + count)?;
        let bytes = [4, 2 * count as u8].into_iter().chain(registers.iter().flat_map(|it| it.to_be_bytes()));
        response.iter_mut().zip(bytes).for_each(|(place, byte)| *place = byte);
        Some(2 + 2 * count)
    }

    /// Returns the registers. A value that is too large is the largest possible one.
    fn registers(&self) -> Vec<u16> {
        let registers = REPORTS.iter().flat_map(|report| {
            let value = (report.value)(self).min(u128::MAX >> (128 - 16 * report.registers));
            (0..report.registers).rev().map(move |word| (value >> (16 * word)) as u16)
        });
        registers.collect()
    }
}

fn bits(address: IpAddr) -> u128 {
    match address {
        IpAddr::V4(address) => address.to_ipv6_mapped().to_bits(),
        IpAddr::V6(address) => address.to_bits(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use document::{hold, table};
    use wsg_bridge_fw::registers::{COMMANDS, FIRST_COMMAND, FIRST_REPORT, REPORTS as OF_BRIDGE};

    const PLC: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(192, 168, 1, 5));

    fn number(measured: &Measured, name: &str) -> u64 {
        let registers = measured.registers();
        match reported(&registers).find(|(report, _)| report.name == name) {
            Some((_, Reported::Number(number))) => number,
            _ => panic!("{name} is not a number"),
        }
    }

    fn address(measured: &Measured) -> Option<IpAddr> {
        reported(&measured.registers()).find_map(|(_, reported)| match reported {
            Reported::Address(address) => address,
            Reported::Number(_) => None,
        })
    }

    #[test]
    fn cycles_of_a_plc_are_measured_until_another_one_writes_or_it_is_silent() {
        let (mut measured, mut now) = (Measured::default(), Duration::from_secs(1));
        let mut write = |measured: &mut Measured, address, after_us| {
            now += Duration::from_micros(after_us);
            measured.note_cycle(address, now);
        };
        write(&mut measured, PLC, 0);
        // Not enough cycles to judge this one.
        write(&mut measured, PLC, 90_000);
        for _ in 0..64 {
            write(&mut measured, PLC, 10_000);
        }
        let of = |measured: &Measured| {
            ["CYCLE_TIME", "JITTER", "MISSED_CYCLES"].map(|name| number(measured, name))
        };
        assert_eq!((of(&measured), address(&measured)), ([10_000, 0, 0], Some(PLC)));
        write(&mut measured, PLC, 20_000);
        assert_eq!(of(&measured), [10_156, 9_844, 0]);
        write(&mut measured, PLC, 20_400);
        assert_eq!(of(&measured), [10_318, 10_082, 1]);

        let other = IpAddr::V6(Ipv6Addr::LOCALHOST);
        write(&mut measured, other, 10_000);
        assert_eq!((of(&measured), address(&measured)), ([0, 0, 1], Some(other)));
        measured.lose_plc();
        assert_eq!((of(&measured), address(&measured)), ([0, 0, 1], None));
    }

    #[test]
    fn only_requests_for_reports_are_answered_and_large_values_saturate() {
        let measured = Measured { pauses: 70_000, master_connections: 70_000, ..Measured::default() };
        assert_eq!((number(&measured, "PAUSES"), number(&measured, "MASTER_CONNECTIONS")), (65_535, 70_000));
        let answer = |request: &[u8], of_bridge: [u8; 2]| {
            let mut response = [0; MAX_PDU_LEN];
            response[..2].copy_from_slice(&of_bridge);
            measured.answer(request, &mut response).map(|len| response[..len].to_vec())
        };
        let missing = [0x84, 2];
        assert_eq!(answer(&[4, 3, 0xE9, 0, 2], missing), Some(vec![4, 4, 0, 1, 0x11, 0x70]));
        let all = answer(&[4, 3, 0xE8, 0, LEN as u8], missing).unwrap();
        assert_eq!(all.len(), 2 + 2 * usize::from(LEN));
        for (request, of_bridge) in [
            (&[4, 3, 0xE8, 0, LEN as u8 + 1][..], missing),
            (&[4, 3, 0xE7, 0, 2], missing),
            (&[3, 3, 0xE8, 0, 2], missing),
            // Wrong quantities.
            (&[4, 3, 0xE8, 0, 0], [0x84, 3]),
            (&[4, 3, 0xE8, 0, 2, 0], [0x84, 3]),
        ] {
            assert_eq!(answer(request, of_bridge), None, "{request:?}");
        }
    }

    #[test]
    fn registers_in_the_document_are_those_of_the_table_and_not_those_of_the_bridge() {
        assert!(
            FIRST_REPORT + OF_BRIDGE.len() as u16 <= FIRST && FIRST_COMMAND + (COMMANDS.len() as u16) < FIRST
        );
        let mut next = FIRST;
        let rows = REPORTS.iter().map(|report| {
            let first = next;
            next += report.registers as u16;
            let address =
                if report.registers == 1 { first.to_string() } else { format!("{first} to {}", next - 1) };
            [address, format!("`{}`", report.name), report.unit.into(), report.meaning.into()]
        });
        hold("docs/gateway.md", "reports", &table(["address", "name", "unit", "meaning"], rows));
    }
}

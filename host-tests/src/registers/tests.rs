use std::sync::{Arc, Mutex};
use std::thread;

use super::*;

#[test]
fn an_it_block_shrinks_with_each_instruction() {
    // ITTE EQ: 0000 1101 behind IT.
    let xpsr = |state: u32| 0x4100_0010 | (state & 0b11) << 25 | (state >> 2) << 10;
    assert_eq!(behind_one_instruction(xpsr(0b0000_0110)), xpsr(0b0000_1100));
    assert_eq!(behind_one_instruction(xpsr(0b0000_1100)), xpsr(0b0001_1000));
    assert_eq!(behind_one_instruction(xpsr(0b0001_1000)), xpsr(0));
    assert_eq!(behind_one_instruction(xpsr(0)), xpsr(0));
}

#[test]
fn time_is_that_of_systick_and_its_milliseconds() {
    let time = |ms: u32, current: u32, icsr: u32| {
        let systick = [79_999u32.to_le_bytes(), current.to_le_bytes()].concat();
        machine_time(&ms.to_le_bytes(), &systick, &icsr.to_le_bytes())
    };
    assert_eq!(time(7, 79_999, 0), Some(Duration::from_millis(7)));
    assert_eq!(time(7, 39_999, 0), Some(Duration::from_micros(7_500)));
    assert_eq!(time(7, 79_999, PENDSTSET), Some(Duration::from_millis(8)), "its exception waits");
    assert_eq!(time(7, 799, PENDSTSET), Some(Duration::from_micros(7_990)), "looked at before it began anew");
    assert_eq!(machine_time(&[0; 4], &[0; 8], &[0; 4]), None, "it is not running");
}

/// One register at 4000_0000h that is what was stored last, plus the microseconds since; its interrupt: 3 ms have passed.
#[derive(Clone, Debug, Default)]
struct Register(Arc<Mutex<u32>>);

impl RegisterModel for Register {
    fn addresses(&self) -> Range<u32> {
        0x4000_0000..0x4000_0004
    }

    fn load(&mut self, address: u32, width: Width) -> Result<u32> {
        ensure_word(address, width)?;
        Ok(*self.0.lock().unwrap())
    }

    fn store(&mut self, address: u32, width: Width, value: u32) -> Result<()> {
        ensure_word(address, width)?;
        *self.0.lock().unwrap() = value;
        Ok(())
    }

    fn advance(&mut self, time: Duration) {
        *self.0.lock().unwrap() += time.as_micros() as u32;
    }

    fn interrupts(&self) -> Vec<(u8, bool)> {
        vec![(19, *self.0.lock().unwrap() >= 2_900)]
    }
}

/// A stub whose machine stops once, at `code` with these registers, after 3 ms; what it was told, what interrupts were set,
/// and how serving ended.
fn one_stop(code: [u16; 2], r0: u32, r1: u32) -> (Vec<String>, Vec<(u8, bool)>, String) {
    use std::io::{Read, Write};
    let (ours, mut stub) = std::os::unix::net::UnixStream::pair().unwrap();
    let stub = thread::spawn(move || {
        let mut told = Vec::new();
        let mut received = Vec::new();
        loop {
            let mut byte = [0];
            if stub.read_exact(&mut byte).is_err() {
                return told;
            }
            received.extend(byte);
            let text = String::from_utf8_lossy(&received).into_owned();
            let Some((packet, sum)) = text.split_once('$').and_then(|(_, rest)| rest.split_once('#')) else {
                continue;
            };
            if sum.len() < 2 {
                continue;
            }
            let answer = match packet {
                "c" if told.iter().any(|packet| packet == "c") => return told,
                "c" => "T05thread:01;awatch:40000000;".to_owned(),
                "g" => {
                    let mut words = [0u32; 17];
                    (words[0], words[1], words[15], words[16]) = (r0, r1, 0x0800_0100, 0x0100_0000);
                    words.map(|word| format!("{:08x}", word.swap_bytes())).concat()
                }
                "m8000100,4" => code.map(|half| format!("{:04x}", half.swap_bytes())).concat(),
                "me000e014,8" => "7f3801007f380100".to_owned(),
                "m20000000,4" => "03000000".to_owned(),
                "me000ed04,4" => "00000000".to_owned(),
                _ => "OK".to_owned(),
            };
            told.push(packet.to_owned());
            received.clear();
            let sum = answer.bytes().fold(0u8, u8::wrapping_add);
            if write!(stub, "+${answer}#{sum:02x}").is_err() {
                return told;
            }
        }
    });
    let gdb = Gdb::new(ours, Duration::from_secs(10)).unwrap();
    let model: Box<dyn RegisterModel> = Box::new(Register::default());
    let mut interrupts = Interrupts(Vec::new());
    let registers = Registers::new(gdb, vec![model], 0x2000_0000).unwrap();
    let ended = registers.serve(&mut interrupts);
    (stub.join().unwrap(), interrupts.0, format!("{:#}", ended.unwrap_err()))
}

/// A machine of interrupt lines.
struct Interrupts(Vec<(u8, bool)>);

impl Machine for Interrupts {
    fn set_interrupt(&mut self, line: u8, level: bool) -> Result<()> {
        self.0.push((line, level));
        Ok(())
    }

    fn raise_nmi(&mut self) -> Result<()> {
        Ok(())
    }

    fn load(&mut self, _: u32) -> Result<u32> {
        Ok(0)
    }

    fn store(&mut self, _: u32, _: u32) -> Result<()> {
        Ok(())
    }
}

#[test]
fn a_load_is_answered_by_the_model_and_skipped() {
    // ldr r1, [r0]
    let (told, interrupts, _) = one_stop([0x6801, 0], 0x4000_0000, 9);
    let written = told.iter().find(|packet| packet.starts_with('G')).unwrap();
    // 2 900 us and that of the access: the interrupt ends what passes by itself.
    assert!(written.starts_with("G00000040690b0000"), "R1 holds what the model says, 2921: {written}");
    assert!(written.ends_with("0201000800000001"), "two bytes on: {written}");
    assert_eq!(interrupts, [(19, true)]);
}

#[test]
fn a_store_reaches_the_model() {
    // str r1, [r0], #4
    let (told, interrupts, _) = one_stop([0xF840, 0x1B04], 0x4000_0000, 0x10);
    let written = told.iter().find(|packet| packet.starts_with('G')).unwrap();
    assert!(written.starts_with("G04000040"), "the base is written back: {written}");
    assert!(written.ends_with("0401000800000001"), "four bytes on: {written}");
    assert_eq!(interrupts, [(19, true), (19, false)], "16 us since");
}

#[test]
fn what_is_not_understood_ends_it_with_the_instruction_and_its_address() {
    let (_, _, ended) = one_stop([0xE9D0, 0x0100], 0x4000_0000, 0);
    assert!(ended.contains("0x08000100") && ended.contains("LDRD"), "{ended}");
    let (_, _, ended) = one_stop([0x7801, 0], 0x4000_0000, 0);
    assert!(ended.contains("0x40000000") && ended.contains("32 bits, not of 8"), "{ended}");
}

//! Serves sixteen holding registers over TCP, one client at a time:
//! `cargo run -p bus-modbus --example tcp_server -- 127.0.0.1:1502`.

use std::env;
use std::io::{self, BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};

use bus_modbus::tcp::{Event, MAX_FRAME_LEN, Receiver};
use bus_modbus::{Bits, Device, Exception, Identification, Words, serve};

#[derive(Default)]
struct Registers([u16; 16]);

const NONE: Exception = Exception::IllegalDataAddress;

impl Device for Registers {
    fn holding_register(&self, address: u16) -> Result<u16, Exception> {
        self.0.get(usize::from(address)).copied().ok_or(NONE)
    }

    fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception> {
        let first = usize::from(first);
        let places = self.0.get_mut(first..first + values.len()).ok_or(NONE)?;
        for (place, value) in places.iter_mut().zip(values.iter()) {
            *place = value;
        }
        Ok(())
    }

    fn coil(&self, _: u16) -> Result<bool, Exception> {
        Err(NONE)
    }

    fn discrete_input(&self, _: u16) -> Result<bool, Exception> {
        Err(NONE)
    }

    fn input_register(&self, _: u16) -> Result<u16, Exception> {
        Err(NONE)
    }

    fn write_coils(&mut self, _: u16, _: Bits<'_>) -> Result<(), Exception> {
        Err(NONE)
    }

    fn identification(&self) -> Identification {
        Identification { vendor_name: "example", product_code: "R16", revision: "1.0", regular: None }
    }
}

fn main() -> io::Result<()> {
    let address = env::args().nth(1).unwrap_or_else(|| "127.0.0.1:1502".to_owned());
    let listener = TcpListener::bind(&address)?;
    println!("listening on {address}");
    let mut device = Registers::default();
    for stream in listener.incoming() {
        if let Err(error) = answer_all(stream?, &mut device) {
            println!("connection lost: {error}");
        }
    }
    Ok(())
}

/// Answers requests until the client closes the connection or sends an invalid length.
fn answer_all(mut stream: TcpStream, device: &mut Registers) -> io::Result<()> {
    let mut reader = BufReader::new(stream.try_clone()?);
    let mut receiver = Receiver::new();
    let mut frame = [0; MAX_FRAME_LEN];
    while !receiver.is_lost() {
        let bytes = reader.fill_buf()?;
        if bytes.is_empty() {
            break;
        }
        let (taken, event) = receiver.push_slice(bytes);
        if let Some(Event::Request(request)) = event {
            stream.write_all(request.answer(&mut frame, |pdu, response| serve(pdu, device, response)))?;
        }
        reader.consume(taken);
    }
    Ok(())
}

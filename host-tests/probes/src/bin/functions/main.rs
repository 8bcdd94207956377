//! Every public function of `wsg-protocol` and of the buses, a module for each part of it.
//!
//! For the target it keeps the address of each function, so that each is there whole, for whatever arguments: it links only
//! if none of them can panic (`cargo xtask panics`), and its size is theirs (`cargo xtask size`). For the host it prints the
//! compiler's own name of each, and `cargo xtask panics` compares them with what rustdoc finds in the crates.
#![cfg_attr(target_os = "none", no_std, no_main)]

use core::any::type_name_of_val;

// Its panic handler.
use wsg_probes as _;

#[cfg(feature = "can")]
mod can;
#[cfg(feature = "can")]
mod canopen;
#[cfg(feature = "drivers")]
mod drivers;
#[cfg(feature = "gcl")]
mod gcl;
#[cfg(feature = "modbus")]
mod modbus;
#[cfg(feature = "profibus")]
mod profibus;
#[cfg(feature = "profinet")]
mod profinet;
#[cfg(feature = "protocol")]
mod protocol;
#[cfg(any(feature = "drivers", feature = "protocol"))]
mod transport;

fn every_function() {
    #[cfg(feature = "protocol")]
    protocol::every_function();
    #[cfg(feature = "gcl")]
    gcl::every_function();
    #[cfg(feature = "modbus")]
    modbus::every_function();
    #[cfg(feature = "can")]
    can::every_function();
    #[cfg(feature = "can")]
    canopen::every_function();
    #[cfg(feature = "profibus")]
    profibus::every_function();
    #[cfg(feature = "profinet")]
    profinet::every_function();
    #[cfg(feature = "drivers")]
    drivers::every_function();
}

/// Keeps the function for the target; prints its name for the host.
fn keep<F>(function: &F, address: *const ()) {
    let name = type_name_of_val(function);
    #[cfg(not(target_os = "none"))]
    println!("{name}");
    core::hint::black_box((address, name.len()));
}

/// Methods whose type parameters, if any, are those of their type.
macro_rules! functions {
    ($($type:ty: $($name:ident),+;)+) => { $($(crate::function!(<$type>::$name);)+)+ };
}

/// One function. Where it takes an `impl Trait`, a pointer's type says which.
macro_rules! function {
    ($function:expr) => {
        crate::keep(&$function, $function as *const ())
    };
    ($function:expr, $pointer:ty) => {{
        let function = $function;
        let pointer: $pointer = function;
        crate::keep(&function, pointer as *const ());
    }};
}

use {function, functions};

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    loop {
        every_function();
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    every_function();
}

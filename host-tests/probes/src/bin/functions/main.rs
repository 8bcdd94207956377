//! Every public function of `wsg-protocol` and of the buses, grouped into modules.
//!
//! On the target, the program keeps the address of each function, so that all are linked for arbitrary arguments. It links only
//! if none can panic (`cargo xtask panics`), and its size is theirs (`cargo xtask size`). On the host, it prints the
//! compiler's name of each function, and `cargo xtask panics` compares the names with rustdoc's list.
#![cfg_attr(target_os = "none", no_std, no_main)]

use core::any::type_name_of_val;

// Links the panic handler.
use wsg_probes as _;

#[cfg(feature = "can")]
mod can;
#[cfg(feature = "can")]
mod canopen;
#[cfg(feature = "drivers")]
mod drivers;
#[cfg(feature = "ethernetip")]
mod ethernetip;
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
    #[cfg(feature = "ethernetip")]
    ethernetip::every_function();
    #[cfg(feature = "profibus")]
    profibus::every_function();
    #[cfg(feature = "profinet")]
    profinet::every_function();
    #[cfg(feature = "drivers")]
    drivers::every_function();
}

/// Keeps the function on the target; prints its name on the host.
fn keep<F>(function: &F, address: *const ()) {
    let name = type_name_of_val(function);
    #[cfg(not(target_os = "none"))]
    println!("{name}");
    core::hint::black_box((address, name.len()));
}

/// Methods without type parameters beyond the parameters of their type.
macro_rules! functions {
    ($($type:ty: $($name:ident),+;)+) => { $($(crate::function!(<$type>::$name);)+)+ };
}

/// A single function. For an `impl Trait` argument, the pointer type selects the concrete type.
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

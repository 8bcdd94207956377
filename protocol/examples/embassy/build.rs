//! Links by the script of `cortex-m-rt`; `embassy-stm32` has the memory of the microcontroller.
fn main() {
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
}

//! Measures the firmware's stack depth: boots an image on painted memory, applies the known worst-case load, and
//! finds the lowest overwritten byte. Prints `painted-stack` and the number of bytes. The emulator needs Unix
//! sockets.

#[cfg(unix)]
mod stack;

use anyhow::Result;

#[cfg(unix)]
fn main() -> Result<()> {
    println!("painted-stack {}", stack::deepest_of_image()?);
    Ok(())
}

#[cfg(not(unix))]
fn main() -> Result<()> {
    anyhow::bail!("the emulator needs Unix sockets")
}

//! How deep the firmware's stack was: boots an image on painted memory, puts it through the worst that is known, and
//! looks how far the paint is gone. Prints one line: `painted-stack` and bytes. The emulator needs Unix sockets.

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

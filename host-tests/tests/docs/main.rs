//! Checks the documents against the code.
//!
//! `WSG_UPDATE_DOCS=1 cargo test -p host-tests --test docs` updates the generated parts.

mod checksum;
mod commands;
mod crate_readme;
mod decisions;
mod dissector;
mod figures;
mod grip_cycle;
mod leds;
mod pictures;
mod pointers;
mod quick_start;
mod security;
mod states;
mod trace_excerpt;
mod wiring;

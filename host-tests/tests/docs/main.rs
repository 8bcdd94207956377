//! What the documents say and the code says is the same.
//!
//! Parts that are made from the code stand between `<!-- generated: NAME -->` and `<!-- end -->`. Here they are
//! compared; `WSG_UPDATE_DOCS=1 cargo test -p host-tests --test docs` writes them anew.

mod checksum;
mod commands;
mod crate_readme;
mod decisions;
mod document;
mod figures;
mod pointers;
mod trace_excerpt;
mod wiring;

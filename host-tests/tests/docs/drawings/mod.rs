//! The pictures of the documents, drawn from what was recorded in virtual time and from the board's tables.

mod states;
mod svg;
mod timing;
mod wiring;

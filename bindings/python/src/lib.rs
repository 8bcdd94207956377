//! The native part of the Python package `wsg-gripper`.
//!
//! The Python part (`python/wsg_gripper`) has the public classes with their documentation. This part has the objects that
//! own a gripper, a stream or a simulator, without types of their own for results: it returns numbers, text and tuples.

mod core;
mod driver;
mod error;
mod feed;
mod interpreter;
mod line;
mod number;
mod protocol;
mod queue;
mod records;
mod sim;
mod stream;
mod updates;

use std::collections::BTreeMap;
use std::ffi::OsString;

use pyo3::prelude::*;
use wsg_protocol::{FingerFlags, GripperState, Status, SystemFlags};

/// The native part of `wsg_gripper`; see the modules of the package.
#[pymodule(gil_used = true)]
mod _native {
    #[pymodule_export]
    use super::driver::{Driver, Motion};
    #[pymodule_export]
    use super::protocol::{Decoder, commands, decode_reply, describe, encode_command, encode_frame};
    #[pymodule_export]
    use super::queue::Ticket;
    #[pymodule_export]
    use super::sim::{Rig, Server};
    #[pymodule_export]
    use super::stream::{Samples, Stream};
    #[pymodule_export]
    use super::updates::Updates;

    use super::*;
    use crate::interpreter::{self, detach};
    use crate::records;

    #[pymodule_init]
    fn begin(_module: &Bound<'_, PyModule>) -> PyResult<()> {
        records::receive();
        Ok(())
    }

    /// Closes all open connections.
    #[pyfunction]
    fn close_all(py: Python<'_>) {
        py.detach(|| {
            interpreter::end();
            crate::core::close_all();
        });
        records::pass_on(py);
    }

    /// Invalidates the connections of the parent in a forked child.
    #[pyfunction]
    fn count_fork() {
        interpreter::count_fork();
    }

    /// Runs the program `wsg` and returns its exit status. The first word is the name of the program.
    #[pyfunction]
    fn run_wsg(py: Python<'_>, words: Vec<OsString>) -> u8 {
        detach(py, || wsg_tool::run(words))
    }

    /// Runs the program `wsg-sim` and returns its exit status. The first word is the name of the program.
    #[pyfunction]
    fn run_wsg_sim(py: Python<'_>, words: Vec<OsString>) -> u8 {
        detach(py, || wsg_sim::program::run(words.into_iter().skip(1)))
    }

    /// Returns the source of the script for set-point streaming.
    #[pyfunction]
    const fn stream_script() -> &'static str {
        wsg_protocol::driver::stream::SCRIPT
    }

    /// Returns the names and numbers of states, flags and status codes, for a test of `_types.py`.
    #[pyfunction]
    fn tables() -> BTreeMap<&'static str, BTreeMap<String, u32>> {
        let state = |state: &GripperState| (state.to_string().replace(' ', "_"), state.code().into());
        BTreeMap::from([
            ("Status", Status::ALL.iter().map(|it| (it.symbol().to_owned(), it.code().into())).collect()),
            ("GripperState", GripperState::ALL.iter().map(state).collect()),
            ("SystemFlags", flags(SystemFlags::all().iter_names().map(|(name, it)| (name, it.bits())))),
            (
                "FingerFlags",
                flags(FingerFlags::all().iter_names().map(|(name, it)| (name, it.bits().into()))),
            ),
        ])
    }
}

fn flags(flags: impl Iterator<Item = (&'static str, u32)>) -> BTreeMap<String, u32> {
    flags.map(|(name, bits)| (name.to_owned(), bits)).collect()
}

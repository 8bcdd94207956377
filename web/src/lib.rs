//! The virtual gripper and the whole station for a web page.
//!
//! The boundary to JavaScript consists of functions over bytes: [`wsg_reserve`] returns where the page writes a request,
//! [`wsg_gripper`] or [`wsg_station`] answers it, and [`wsg_answer`] returns where the page reads. Requests and answers are JSON in
//! UTF-8.
//!
//! `wasm-bindgen` would need a program whose version equals that of its crate, and generates more JavaScript than this boundary has:
//! 12 lines in a worker.

mod gripper;
pub mod station;

use std::cell::RefCell;

/// Has half the code of the standard library's allocator.
#[cfg(target_family = "wasm")]
#[global_allocator]
static ALLOCATOR: talc::wasm::WasmDynamicTalc = talc::wasm::new_wasm_dynamic_allocator();

thread_local! {
    /// The request of the page, and the answer that replaces it.
    static BUFFER: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

/// Returns the address of a buffer of `len` bytes for the next request.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_reserve(len: usize) -> *mut u8 {
    BUFFER.with_borrow_mut(|buffer| {
        buffer.clear();
        buffer.resize(len, 0);
        buffer.as_mut_ptr()
    })
}

/// Answers the request in the buffer to the gripper's page, and returns the length of the answer.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_gripper() -> usize {
    answer(gripper::call)
}

/// Answers the request in the buffer to the station's page, and returns the length of the answer.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_station() -> usize {
    answer(|request| station::call(std::str::from_utf8(request).unwrap_or_default()).into_bytes())
}

/// Returns the address of the answer, until the next call.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_answer() -> *const u8 {
    BUFFER.with_borrow(|buffer| buffer.as_ptr())
}

/// Replaces the request in the buffer with its answer.
fn answer(call: impl FnOnce(&[u8]) -> Vec<u8>) -> usize {
    BUFFER.with_borrow_mut(|buffer| {
        *buffer = call(buffer);
        buffer.len()
    })
}

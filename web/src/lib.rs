//! The virtual gripper and the whole station for a web page.
//!
//! The boundary to JavaScript consists of three functions over bytes: [`wsg_reserve`] returns where the page writes a
//! request, [`wsg_call`] answers it, and [`wsg_answer`] returns where the page reads. Requests and answers are JSON in UTF-8.

use std::cell::RefCell;

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

/// Answers the request in the buffer, and returns the length of the answer.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_call() -> usize {
    BUFFER.with_borrow_mut(|buffer| {
        *buffer = b"{}".to_vec();
        buffer.len()
    })
}

/// Returns the address of the answer, until the next call.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_answer() -> *const u8 {
    BUFFER.with_borrow(|buffer| buffer.as_ptr())
}

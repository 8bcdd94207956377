//! The boundary to C memory: the only conversions of pointers with a length.

use core::ffi::c_char;

use crate::error::wsg_error;

/// Returns the bytes at a pointer of C. A null pointer is accepted for an empty slice.
///
/// # Safety
/// `data` is null or points to `length` initialized bytes that live and stay unchanged during `'a`.
pub unsafe fn bytes<'a>(data: *const u8, length: usize) -> Result<&'a [u8], wsg_error> {
    if length == 0 {
        return Ok(&[]);
    }
    if data.is_null() {
        return Err(wsg_error::NullPointer);
    }
    if length > isize::MAX as usize {
        return Err(wsg_error::TooLong);
    }
    // SAFETY: not null, not longer than a slice may be, and valid according to the caller.
    Ok(unsafe { core::slice::from_raw_parts(data, length) })
}

/// Returns the buffer at a pointer of C.
///
/// # Safety
/// `data` is null or points to `length` bytes that only the caller uses during `'a`.
pub unsafe fn buffer<'a>(data: *mut u8, length: usize) -> Result<&'a mut [u8], wsg_error> {
    if data.is_null() {
        return Err(wsg_error::NullPointer);
    }
    if length > isize::MAX as usize {
        return Err(wsg_error::TooLong);
    }
    // SAFETY: not null, not longer than a slice may be, and valid according to the caller. Any byte is a valid `u8`.
    Ok(unsafe { core::slice::from_raw_parts_mut(data, length) })
}

/// Returns the characters of a NUL-terminated text without the NUL. Reads at most `max_len` + 1 bytes.
///
/// # Safety
/// `text` is null or points to a NUL-terminated text, or to at least `max_len` + 1 bytes, which live during `'a`.
pub(crate) unsafe fn text<'a>(text: *const c_char, max_len: usize) -> Result<&'a [u8], wsg_error> {
    if text.is_null() {
        return Err(wsg_error::NullPointer);
    }
    let mut length = 0usize;
    // SAFETY: every byte up to the NUL is valid, and the loop ends there.
    while unsafe { text.add(length).read() } != 0 {
        length = length.saturating_add(1);
        if length > max_len {
            return Err(wsg_error::TooLong);
        }
    }
    // SAFETY: these bytes were read above.
    unsafe { bytes(text.cast(), length) }
}

/// Writes a result to the caller's object, which may be uninitialized.
pub(crate) fn give<T>(target: Option<&mut core::mem::MaybeUninit<T>>, value: T) -> Result<(), wsg_error> {
    target.ok_or(wsg_error::NullPointer)?.write(value);
    Ok(())
}

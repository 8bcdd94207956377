//! Numbers of the gripper, which are single precision, as Python's doubles.

/// Returns the double with the shortest decimal that stands for this number: 19.6 and not 19.600000381469727.
pub(crate) fn shortest(number: f32) -> f64 {
    // The text of a number is always a number.
    number.to_string().parse().unwrap_or_else(|_| f64::from(number))
}

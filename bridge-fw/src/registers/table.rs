//! Tables with a part that is generated.

/// Returns a table of what stands before a generated part, that part, and what stands behind it. A constant: a length that is
/// not that of the parts does not compile.
pub(super) const fn joined<
    T: Copy,
    const BEFORE: usize,
    const EACH: usize,
    const COUNT: usize,
    const BEHIND: usize,
    const ALL: usize,
>(
    before: [T; BEFORE],
    generated: [[T; EACH]; COUNT],
    behind: [T; BEHIND],
) -> [T; ALL] {
    const { assert!(ALL == BEFORE + EACH * COUNT + BEHIND) }
    let generated = generated.as_flattened();
    #[expect(clippy::indexing_slicing, reason = "at compile time, where a wrong index does not compile")]
    {
        let mut all = [before[0]; ALL];
        let mut at = 0;
        while at < ALL {
            all[at] = if at < BEFORE {
                before[at]
            } else if at < BEFORE + generated.len() {
                generated[at - BEFORE]
            } else {
                behind[at - BEFORE - generated.len()]
            };
            at += 1;
        }
        all
    }
}

//! The page: one file with its script, and its content security policy.

use std::hash::{BuildHasher, RandomState};

const PAGE: &str = include_str!("page.html");
/// Placeholder for the nonce in the page.
const PLACE: &str = "{{nonce}}";

/// Returns the page and its content security policy. The policy allows the page's own script and style and requests to
/// its own origin; it forbids framing.
pub(super) fn page() -> (String, String) {
    // A new hasher is seeded from the system's random numbers.
    let nonce = format!("{:016x}{:016x}", RandomState::new().hash_one(0), RandomState::new().hash_one(1));
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    (PAGE.replace(PLACE, &nonce), policy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_asks_nobody_else_for_anything_and_runs_nothing_inline() {
        let (page, policy) = page();
        for foreign in
            ["http:", "https:", "//cdn", "@import", "url(", " onclick=", " style=\"", "innerHTML", "eval("]
        {
            let page = page.replace("http://www.w3.org/2000/svg", "");
            assert!(!page.contains(foreign), "{foreign}");
        }
        assert!(!page.contains(PLACE));
        let (_, other) = super::page();
        assert_ne!(policy, other, "each nonce is used only once");
    }
}

//! The page: one file with its script, and what a browser may do with it.

use std::hash::{BuildHasher, RandomState};

const PAGE: &str = include_str!("page.html");
/// Stands in the page where the nonce goes.
const PLACE: &str = "{{nonce}}";

/// The page, and the content security policy that goes with it: its own script and style, requests to where it came from,
/// and nothing else; no other page frames it.
pub(super) fn page() -> (String, String) {
    // A new hasher has keys of the system's random numbers.
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
        assert_ne!(policy, other, "a nonce is used once");
    }
}

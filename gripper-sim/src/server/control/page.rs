//! The page: plain files, delivered as one document with its style and scripts, and its content security policy. `cargo xtask web`
//! copies the same files for a page without a server.

use std::hash::{BuildHasher, RandomState};

const PAGE: &str = include_str!("page/index.html");
const STYLE: &str = include_str!("page/style.css");
/// The scripts that the page names.
const SCRIPTS: [(&str, &str); 9] = [
    ("over_http.js", include_str!("page/over_http.js")),
    ("core.js", include_str!("page/core.js")),
    ("operate.js", include_str!("page/operate.js")),
    ("plot.js", include_str!("page/plot.js")),
    ("settings.js", include_str!("page/settings.js")),
    ("fieldbus.js", include_str!("page/fieldbus.js")),
    ("editor.js", include_str!("page/editor.js")),
    ("scripts.js", include_str!("page/scripts.js")),
    ("logs.js", include_str!("page/logs.js")),
];
/// Placeholder for the nonce in the page.
const PLACE: &str = "{{nonce}}";

/// Returns the page for a browser that knows this server by the name `host`, and its content security policy. The policy
/// allows the page's own script and style and requests to its own origin; it forbids framing.
pub(super) fn page(host: &str) -> (String, String) {
    // Older browsers do not count WebSockets as `self`.
    let is_name = |byte: u8| byte.is_ascii_alphanumeric() || b".:-[]".contains(&byte);
    let sockets =
        if host.bytes().all(is_name) { format!(" ws://{host} wss://{host}") } else { String::new() };
    // One document, because a browser has few connections to a server.
    let style = format!("<style nonce=\"{PLACE}\">{STYLE}</style>");
    let page = PAGE.replace("<link rel=\"stylesheet\" href=\"style.css\">", &style);
    let page = SCRIPTS.iter().fold(page, |page, (name, text)| {
        let inline = format!("<script nonce=\"{PLACE}\">\n{text}</script>");
        page.replace(&format!("<script src=\"{name}\"></script>"), &inline)
    });
    guarded(&page, &sockets)
}

/// Returns a page with its nonce, and its content security policy. `sockets` are further places to which it may connect.
pub(super) fn guarded(page: &str, sockets: &str) -> (String, String) {
    // A new hasher is seeded from the system's random numbers.
    let nonce = format!("{:016x}{:016x}", RandomState::new().hash_one(0), RandomState::new().hash_one(1));
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'{sockets}; \
         img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    (page.replace(PLACE, &nonce), policy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_loads_nothing_from_elsewhere_and_runs_no_inline_script() {
        let (page, policy) = page("localhost:8080");
        assert!(
            policy.contains(" connect-src 'self' ws://localhost:8080 wss://localhost:8080; "),
            "{policy}"
        );
        for foreign in
            ["http:", "https:", "//cdn", "@import", "url(", " onclick=", " style=\"", "innerHTML", "eval("]
        {
            let page = page.replace("http://www.w3.org/2000/svg", "");
            assert!(!page.contains(foreign), "{foreign}");
        }
        let is_inline = ["{{", "src=", "rel=\"stylesheet\""].iter().all(|file| !page.contains(file));
        assert!(is_inline, "each placeholder and each file is replaced");
        let (_, other) = super::page("user;script-src *@localhost");
        assert!(other.contains(" connect-src 'self'; "), "{other}");
        assert_ne!(policy, other, "each nonce is used only once");
    }
}

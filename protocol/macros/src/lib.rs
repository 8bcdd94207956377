//! Macros of `wsg-protocol`, not for other crates: an attribute that generates the blocking driver from the async driver, and
//! a derive without output.

use proc_macro::{Group, Ident, Literal, TokenStream, TokenTree};

const ASYNC: &str = "#[cfg(feature = \"embedded-io-async\")]";
const BLOCKING: &str = "#[cfg(feature = \"embedded-io\")]";

/// Emits an async item twice: unchanged for feature `embedded-io-async`, and as a blocking item for feature `embedded-io`.
///
/// The blocking item has no `async` and no `.await`. `#[also_blocking(Timer = Clock)]` also replaces the name `Timer` by
/// `Clock` there, in code and in documentation.
#[proc_macro_attribute]
pub fn also_blocking(names: TokenStream, item: TokenStream) -> TokenStream {
    let names = names.into_iter().filter(|token| matches!(token, TokenTree::Ident(_)));
    let names: Vec<String> = names.map(|name| name.to_string()).collect();
    let cfg = |text: &str| text.parse::<TokenStream>().expect("the attribute is valid");
    [cfg(ASYNC), item.clone(), cfg(BLOCKING), blocking(item, &names)].into_iter().collect()
}

/// Derives nothing. It replaces `defmt::Format` without feature `defmt`, so that types need no `cfg_attr`.
#[proc_macro_derive(Format)]
pub fn format(_item: TokenStream) -> TokenStream {
    TokenStream::new()
}

/// Returns the code without `async` and `.await`. `names` alternates between a name and its replacement.
fn blocking(code: TokenStream, names: &[String]) -> TokenStream {
    let mut result = vec![];
    for token in code {
        let span = token.span();
        let mut token = match token {
            TokenTree::Group(group) => Group::new(group.delimiter(), blocking(group.stream(), names)).into(),
            TokenTree::Ident(name) => match name.to_string().as_str() {
                "async" => continue,
                "await" => {
                    // Also remove the dot before it.
                    result.pop();
                    continue;
                }
                text => match names.chunks_exact(2).find(|pair| pair[0] == text) {
                    Some(pair) => Ident::new(&pair[1], span).into(),
                    None => name.into(),
                },
            },
            TokenTree::Literal(literal) => {
                let replace = |text: String, pair: &[String]| text.replace(&pair[0], &pair[1]);
                let text = names.chunks_exact(2).fold(literal.to_string(), replace);
                text.parse::<Literal>().expect("a literal").into()
            }
            punctuation @ TokenTree::Punct(_) => punctuation,
        };
        token.set_span(span);
        result.push(token);
    }
    result.into_iter().collect()
}

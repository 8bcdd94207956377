//! The names of the manual and unknown names: spelling, display and comparison.

use wsg_protocol::gcl::{CommandName, Named, Request};

fn named(spelled: &str) -> Named<'_> {
    Named::at_start_of(spelled.as_bytes())
}

#[test]
fn every_name_of_the_manual_is_found_in_upper_and_lower_case() {
    for name in CommandName::ALL {
        let text = name.text();
        assert_eq!(CommandName::from_text(text), Some(*name));
        assert_eq!(CommandName::from_text(&text.to_lowercase()), Some(*name));
        assert_eq!(CommandName::from_text(&text[1..]), None, "{text} without its first letter");
        assert_eq!((name.to_string(), named(text).to_string()), (text.to_owned(), text.to_owned()));
    }
}

#[test]
fn other_name_is_kept_as_it_was_spelled_and_shown_in_upper_case() {
    let refused = Request::parse(b"Dance(3)").unwrap_err();
    let Named::Other(other) = refused.name else { panic!("{:?}", refused.name) };
    assert_eq!(other.text(), "Dance");
    assert_eq!(refused.name.to_string(), "DANCE");
    assert_eq!(refused.name.command(), None);
    assert_eq!(named("move(50)").command(), Some(CommandName::Move));
}

#[test]
fn names_are_equal_in_any_case_and_to_no_other() {
    let names = ["move", "stop", "dance", "hello", ""];
    for (at, one) in names.into_iter().enumerate() {
        assert_eq!(named(one), named(&one.to_uppercase()));
        for other in &names[at + 1..] {
            assert_ne!(named(one), named(other));
        }
    }
}

#[test]
fn only_idempotent_commands_are_repeatable() {
    let once: Vec<&str> =
        CommandName::ALL.iter().filter(|name| !name.is_repeatable()).map(|name| name.text()).collect();
    assert_eq!(once, ["BYE", "HOME", "MOVE", "GRIP", "RELEASE", "FSACK"]);
}

//! JSON as Python writes it.

use std::borrow::Cow;

/// Python's json writes NaN, Infinity and -Infinity bare, which JSON does not have: outside strings they become null.
pub fn nan_to_null(text: &str) -> Cow<'_, str> {
    if !text.contains("NaN") && !text.contains("Infinity") {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(quote) = rest.find('"') {
        let (between, from) = rest.split_at(quote);
        let (string, after) = from.split_at(string_length(from));
        out.push_str(&replaced(between));
        out.push_str(string);
        rest = after;
    }
    Cow::Owned(out + &replaced(rest))
}

fn replaced(between: &str) -> Cow<'_, str> {
    if !between.contains(['N', 'I']) {
        return Cow::Borrowed(between);
    }
    Cow::Owned(between.replace("-Infinity", "null").replace("Infinity", "null").replace("NaN", "null"))
}

/// Bytes of the string that `text` begins with, with its quotes; all of them where it does not end.
fn string_length(text: &str) -> usize {
    let mut escaped = false;
    for (i, byte) in text.bytes().enumerate().skip(1) {
        if byte == b'"' && !escaped {
            return i + 1;
        }
        escaped = byte == b'\\' && !escaped;
    }
    text.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_stands_outside_strings_is_replaced() {
        let cases = [
            ("[NaN, -Infinity,Infinity]", "[null, null,null]"),
            (r#"{"Infinity_room": NaN}"#, r#"{"Infinity_room": null}"#),
            (
                r#"["NaN/0.png", NaN, "é\"NaN", Infinity, "\\", NaN]"#,
                r#"["NaN/0.png", null, "é\"NaN", null, "\\", null]"#,
            ),
            ("[NaN, \"NaN", "[null, \"NaN"),
        ];
        for (text, expected) in cases {
            assert_eq!(nan_to_null(text), expected);
        }
    }

    #[test]
    fn what_is_json_already_stays() {
        let text = r#"{"a": [1, null, "I"]}"#;
        assert!(matches!(nan_to_null(text), Cow::Borrowed(same) if same == text));
    }
}

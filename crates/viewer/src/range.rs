//! The header `Range`, with a single range (RFC 9110, section 14).

/// First byte and number of bytes that a header asks for of `length`; `None` when it asks for all or is not understood, an error when nothing
/// of the range exists.
pub(crate) fn parse(header: &str, length: u64) -> Result<Option<(u64, u64)>, ()> {
    let Some((first, last)) = header.strip_prefix("bytes=").and_then(|spec| spec.split_once('-')) else {
        return Ok(None);
    };
    let number = |text: &str| text.trim().parse::<u64>();
    let (start, end) = match (number(first), number(last)) {
        (Ok(start), Ok(end)) => (start, end.min(length.saturating_sub(1))),
        (Ok(start), Err(_)) if last.is_empty() => (start, length.saturating_sub(1)),
        (Err(_), Ok(count)) if first.is_empty() && count > 0 => {
            (length.saturating_sub(count), length.saturating_sub(1))
        }
        _ => return Ok(None),
    };
    if start < length && start <= end { Ok(Some((start, end - start + 1))) } else { Err(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_cut_to_what_is_there() {
        assert_eq!(parse("bytes=0-3", 10), Ok(Some((0, 4))));
        assert_eq!(parse("bytes=8-", 10), Ok(Some((8, 2))));
        assert_eq!(parse("bytes=-3", 10), Ok(Some((7, 3))));
        assert_eq!(parse("bytes=-30", 10), Ok(Some((0, 10))));
        assert_eq!(parse("bytes=5-99", 10), Ok(Some((5, 5))));
        assert_eq!(parse("bytes=10-", 10), Err(()));
        assert_eq!(parse("bytes=4-2", 10), Err(()));
        assert_eq!(parse("bytes=0-", 0), Err(()));
        for whole in ["", "bytes=", "bytes=-", "bytes=-0", "lines=1-2", "bytes=0-1,3-4", "bytes=a-b"] {
            assert_eq!(parse(whole, 10), Ok(None), "{whole}");
        }
    }
}

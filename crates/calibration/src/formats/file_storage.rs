//! Files of OpenCV's `FileStorage`, as XML or YAML.

use roxmltree::Document;
use std::collections::BTreeMap;

/// Numbers of every key, matrices row by row; scalars are one number.
pub(super) type Values = BTreeMap<String, Vec<f64>>;

/// The `N` numbers of a key.
pub(super) fn value<'a, const N: usize>(values: &'a Values, key: &str) -> Option<&'a [f64; N]> {
    values.get(key)?.as_slice().try_into().ok()
}

/// Reads either form. What is no number, such as a date, is passed over.
pub(super) fn parse(text: &str) -> Result<Values, String> {
    let text = text.trim_start_matches('\u{feff}').trim_start();
    if text.starts_with('<') { parse_xml(text) } else { parse_yaml(text) }
}

/// Keys are the elements of `<opencv_storage>`; the numbers of a matrix are in its `<data>`.
fn parse_xml(text: &str) -> Result<Values, String> {
    let document = Document::parse(text).map_err(|e| e.to_string())?;
    let mut values = Values::new();
    for entry in document.root_element().children().filter(roxmltree::Node::is_element) {
        let matrix = entry.children().find(|n| n.has_tag_name("data"));
        let words = matrix.unwrap_or(entry).text().unwrap_or_default().split_whitespace();
        let found: Result<Vec<f64>, String> = words.map(number).collect();
        let key = entry.tag_name().name().to_owned();
        match found {
            Ok(found) => values.extend((!found.is_empty()).then_some((key, found))),
            Err(reason) if matrix.is_some() => return Err(format!("{key}: {reason}")),
            Err(_) => {}
        }
    }
    Ok(values)
}

/// OpenCV's YAML starts with `%YAML:1.0` and uses the tag `!!opencv-matrix`, which YAML readers refuse; its files need no more of YAML than this.
fn parse_yaml(text: &str) -> Result<Values, String> {
    let mut values = Values::new();
    let mut key = String::new();
    let mut open: Option<String> = None;
    for line in text.lines().map(str::trim_end).filter(|l| !l.starts_with(['%', '#']) && *l != "---") {
        if let Some(data) = &mut open {
            data.push_str(line);
        } else if let Some((name, rest)) = line.split_once(':') {
            let (indented, name, rest) = (line.starts_with([' ', '\t']), name.trim(), rest.trim());
            if !indented {
                name.trim_matches('"').clone_into(&mut key);
            }
            match (indented, name, rest.starts_with('[')) {
                (true, "data", _) | (false, _, true) => open = Some(rest.to_owned()),
                (false, ..) => {
                    values.extend(number(rest).ok().map(|v| (key.clone(), vec![v])));
                }
                _ => {}
            }
        }
        if open.as_ref().is_some_and(|data| data.contains(']')) {
            values.insert(
                key.clone(),
                numbers(&open.take().unwrap_or_default()).map_err(|e| format!("{key}: {e}"))?,
            );
        }
    }
    Ok(values)
}

fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let inner = text.trim_start_matches('[').split(']').next().unwrap_or_default();
    inner.split(',').map(str::trim).filter(|w| !w.is_empty()).map(number).collect()
}

/// OpenCV writes `.Nan` and `-.Inf`, and Rust reads them without the dot; a dot before digits is a decimal point.
fn number(word: &str) -> Result<f64, String> {
    let unsigned = word.strip_prefix(['+', '-']).unwrap_or(word);
    let is_named = ["nan", "inf"]
        .iter()
        .any(|name| unsigned.strip_prefix('.').is_some_and(|rest| rest.eq_ignore_ascii_case(name)));
    let plain = if is_named { &word.replacen('.', "", 1) } else { word };
    plain.parse().map_err(|_| format!("'{word}' is not a number"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dot_is_a_decimal_point_but_before_nan_and_inf() {
        for (word, value) in
            [(".5", 0.5), (".08", 0.08), ("-.25", -0.25), ("+.5e1", 5.0), ("3.", 3.0), ("-7", -7.0)]
        {
            assert_eq!(number(word), Ok(value), "{word}");
        }
        for (word, value) in [(".Inf", f64::INFINITY), ("-.Inf", f64::NEG_INFINITY), ("+.inf", f64::INFINITY)]
        {
            assert_eq!(number(word), Ok(value), "{word}");
        }
        assert!([".Nan", "-.NaN", ".nan"].iter().all(|word| number(word).unwrap().is_nan()));
        assert!(["..5", ".", "-.", "..Nan", ".infinity5", ""].iter().all(|word| number(word).is_err()));
        let yaml = "dist: !!opencv-matrix\n   data: [ .08, -.5, 0., .001 ]\nscale: .5\n";
        let values = parse(yaml).unwrap();
        assert_eq!((&values["dist"][..], &values["scale"][..]), (&[0.08, -0.5, 0.0, 0.001][..], &[0.5][..]));
    }

    #[test]
    fn opencvs_xml_is_read_in_all_its_forms() {
        let text = "\u{feff}<?xml version=\"1.0\"?>\n<opencv_storage>\n<time>\"Mon 3 May\"</time>\n<K type_id=\"opencv-matrix\"><rows>2</rows>\
            <cols>2</cols><dt>d</dt><data>\n 1. 2.5e+02\n -3 0.</data></K>\n<H>1080</H><v>1 2</v><bad type_id=\"opencv-matrix\"><data>.Nan</data></bad>\
            </opencv_storage>\n";
        let values = parse(text).unwrap();
        assert_eq!(values["K"], [1.0, 250.0, -3.0, 0.0]);
        assert_eq!((&values["H"][..], &values["v"][..]), (&[1080.0][..], &[1.0, 2.0][..]));
        assert!(values["bad"][0].is_nan() && !values.contains_key("time"));
        let wrong = "<opencv_storage><K type_id=\"opencv-matrix\"><data>1 x</data></K></opencv_storage>";
        assert!(parse(wrong).unwrap_err().contains('x'));
        assert!(parse("<opencv_storage><K>").is_err(), "truncated");
    }

    #[test]
    fn opencvs_yaml_is_read_in_all_its_forms() {
        let text = "%YAML:1.0\n---\nnames:\n  - \"01\"\nK_01: !!opencv-matrix\n   rows: 2\n   cols: 2\n   dt: d\n   \
            data: [ 1., 2.5e+02,\n       -3, 0. ]\nH_01: 1080\nv: [1, 2]\nbad: !!opencv-matrix\n   data: [ .Nan ]\n";
        let values = parse(text).unwrap();
        assert_eq!(values["K_01"], [1.0, 250.0, -3.0, 0.0]);
        assert_eq!(
            (values["H_01"].as_slice(), values["v"].as_slice()),
            ([1080.0].as_slice(), [1.0, 2.0].as_slice())
        );
        assert!(values["bad"][0].is_nan());
        assert!(parse("K: !!opencv-matrix\n   data: [ x ]\n").unwrap_err().contains('x'));
    }
}

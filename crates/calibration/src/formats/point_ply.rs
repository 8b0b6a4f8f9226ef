//! Points of a PLY, binary or text: `x`, `y`, `z`, and `red`, `green`, `blue` where it has colours.

use super::left_out::usable_points;
use crate::{CalibrationError, ColouredPoint};
use ffgs_core::open_input;
use glam::DVec3;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{Header, Property, PropertyAccess, PropertyAccessResult};
use std::io::BufReader;
use std::path::Path;

/// Colour of points without one (sRGB).
const GREY: [u8; 3] = [128; 3];

/// The points of a file, in its order; those that are no places are left out, which `skipped` tells.
///
/// # Errors
/// When the file cannot be read, is no PLY, is cut off, or has no positions.
pub(super) fn read_points(
    file: &Path,
    skipped: &mut Vec<String>,
) -> Result<Vec<ColouredPoint>, CalibrationError> {
    let fail = |reason: String| CalibrationError::content(file, reason);
    let opened = open_input(file).map_err(|e| CalibrationError::io(file, e))?;
    let mut reader = Reader::new(BufReader::new(opened));
    let header = Parser::<Vertex>::new().read_header(&mut reader).map_err(|e| fail(e.to_string()))?;
    let positions = ["x", "y", "z"].iter().all(|name| has_property(&header, name));
    if !positions {
        return Err(fail("its vertices have no x, y and z".to_owned()));
    }
    for element in header.elements.values() {
        let is_vertex = element.name == VERTEX;
        // What lies before the vertices is read to get past it.
        let rows = Parser::<Vertex>::new()
            .read_payload_for_element(&mut reader, element, &header)
            .map_err(|e| fail(e.to_string()))?;
        if is_vertex {
            return Ok(usable_points(rows.into_iter().map(|v| v.0).collect(), file, skipped));
        }
    }
    Ok(Vec::new())
}

const VERTEX: &str = "vertex";

fn has_property(header: &Header, name: &str) -> bool {
    header.elements.get(VERTEX).is_some_and(|vertex| vertex.properties.contains_key(name))
}

struct Vertex(ColouredPoint);

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self(ColouredPoint { position: DVec3::ZERO, colour: GREY })
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        let point = &mut self.0;
        match (name, number(&value)) {
            ("x", Some(v)) => point.position.x = v,
            ("y", Some(v)) => point.position.y = v,
            ("z", Some(v)) => point.position.z = v,
            ("red", Some(_)) => point.colour[0] = level(&value),
            ("green", Some(_)) => point.colour[1] = level(&value),
            ("blue", Some(_)) => point.colour[2] = level(&value),
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

fn number(value: &Property) -> Option<f64> {
    Some(match *value {
        Property::Char(v) => v.into(),
        Property::UChar(v) => v.into(),
        Property::Short(v) => v.into(),
        Property::UShort(v) => v.into(),
        Property::Int(v) => v.into(),
        Property::UInt(v) => v.into(),
        Property::Float(v) => v.into(),
        Property::Double(v) => v,
        _ => return None,
    })
}

/// A colour's level (0 to 255); floating-point colours reach from 0 to 1.
fn level(value: &Property) -> u8 {
    let scale = if matches!(value, Property::Float(_) | Property::Double(_)) { 255.0 } else { 1.0 };
    (number(value).unwrap_or_default() * scale).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(content: &[u8]) -> Result<Vec<ColouredPoint>, CalibrationError> {
        points_and_skipped(content).map(|(points, _)| points)
    }

    fn points_and_skipped(content: &[u8]) -> Result<(Vec<ColouredPoint>, Vec<String>), CalibrationError> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("points.ply");
        std::fs::write(&file, content).unwrap();
        let mut skipped = Vec::new();
        read_points(&file, &mut skipped).map(|points| (points, skipped))
    }

    const BINARY: &str = "ply\nformat binary_little_endian 1.0\nelement camera 1\nproperty uchar id\nelement vertex 2\n\
        property double x\nproperty double y\nproperty double z\nproperty uchar red\nproperty uchar green\n\
        property uchar blue\nproperty float nx\nend_header\n";

    fn binary() -> Vec<u8> {
        binary_with(f64::NAN)
    }

    /// Two points, the second with this x.
    fn binary_with(second: f64) -> Vec<u8> {
        let row = |x: f64| {
            let position = [x, 2.0, 3.0].map(f64::to_le_bytes).concat();
            [position, vec![255, 0, 51], 0.5_f32.to_le_bytes().to_vec()].concat()
        };
        [BINARY.as_bytes().to_vec(), vec![7], row(1.0), row(second)].concat()
    }

    #[test]
    fn binary_points_are_read_and_those_that_are_not_finite_left_out() {
        let expected = ColouredPoint { position: DVec3::new(1.0, 2.0, 3.0), colour: [255, 0, 51] };
        for no_place in [f64::NAN, f64::NEG_INFINITY, 1e39] {
            let (points, skipped) = points_and_skipped(&binary_with(no_place)).unwrap();
            assert_eq!(points, [expected], "{no_place}");
            assert!(skipped.len() == 1 && skipped[0].contains("points.ply: 1 of 2 points"), "{skipped:?}");
        }
        let (points, skipped) = points_and_skipped(&binary_with(2.0)).unwrap();
        assert!(points.len() == 2 && skipped.is_empty(), "{skipped:?}");
    }

    #[test]
    fn text_with_colours_from_0_to_1_and_without_colours() {
        let text = |colours: &str, row: &str| {
            format!(
                "ply\nformat ascii 1.0\ncomment x\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
                 {colours}end_header\n{row}\n"
            )
        };
        let colours = "property float red\nproperty float green\nproperty float blue\n";
        let read = |text: String| points(text.as_bytes()).unwrap()[0];
        assert_eq!(read(text(colours, "1 2 -3.5 0 1 0.2")).colour, [0, 255, 51]);
        let plain = read(text("", "1 2 -3.5"));
        assert_eq!((plain.position, plain.colour), (DVec3::new(1.0, 2.0, -3.5), GREY));
    }

    #[test]
    fn damaged_files_are_refused() {
        let sound = binary();
        let without_z = BINARY.replace("double z", "double w");
        let hostile = BINARY.replace("vertex 2", "vertex 99999999999");
        for bad in [&sound[..sound.len() - 3], b"ply\n", b"no", without_z.as_bytes(), hostile.as_bytes()] {
            let error = points(bad).unwrap_err().to_string();
            assert!(error.contains("points.ply"), "{error}");
        }
    }
}

//! Colour maps, as 8-bit RGB.

/// Viridis (matplotlib), every eighth of its range; `at` in 0..=1, clamped.
pub(crate) fn viridis(at: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 9] = [
        [68., 1., 84.],
        [71., 44., 122.],
        [59., 81., 139.],
        [44., 113., 142.],
        [33., 144., 141.],
        [39., 173., 129.],
        [92., 200., 99.],
        [170., 220., 50.],
        [253., 231., 37.],
    ];
    interpolate(&STOPS, at)
}

/// Inferno (matplotlib), every eighth of its range; `at` in 0..=1, clamped.
pub(crate) fn inferno(at: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 9] = [
        [0., 0., 4.],
        [31., 12., 72.],
        [85., 15., 109.],
        [136., 34., 106.],
        [186., 54., 85.],
        [227., 89., 51.],
        [249., 140., 10.],
        [249., 201., 50.],
        [252., 255., 164.],
    ];
    interpolate(&STOPS, at)
}

fn interpolate(stops: &[[f64; 3]; 9], at: f64) -> [u8; 3] {
    let at = if at > 0.0 { at.min(1.0) * 8.0 } else { 0.0 };
    let low = (at as usize).min(7);
    let share = at - low as f64;
    std::array::from_fn(|c| (stops[low][c] + share * (stops[low + 1][c] - stops[low][c])).round() as u8)
}

/// Hue in turns (any real), saturation and value in 0..=1.
pub(crate) fn hsv(hue: f64, saturation: f64, value: f64) -> [u8; 3] {
    let channel = |offset: f64| {
        let k = (offset + 6.0 * hue.rem_euclid(1.0)).rem_euclid(6.0);
        let dip = k.min(4.0 - k).clamp(0.0, 1.0);
        (255.0 * value * (1.0 - saturation * dip)).round() as u8
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wheel_starts_at_red_and_turns_by_thirds() {
        assert_eq!(hsv(0.0, 1.0, 1.0), [255, 0, 0]);
        assert_eq!(hsv(1.0 / 3.0, 1.0, 1.0), [0, 255, 0]);
        assert_eq!(hsv(-1.0 / 3.0, 1.0, 1.0), [0, 0, 255]);
        assert_eq!(hsv(0.4, 0.0, 1.0), [255; 3]);
    }

    #[test]
    fn maps_end_where_they_should_for_any_number() {
        assert_eq!(viridis(-3.0), [68, 1, 84]);
        assert_eq!(viridis(7.0), [253, 231, 37]);
        assert_eq!(inferno(f64::NAN), [0, 0, 4]);
    }
}

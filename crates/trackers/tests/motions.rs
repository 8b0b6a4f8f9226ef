//! Pictures that move in known ways.

use ffgs_core::{ImageRgb8, ImageSize, Mask, TrackSet};
use ffgs_trackers::{Frame, TrackerConfig, lucas_kanade, matches};

const SIZE: ImageSize = ImageSize { width: 320, height: 180 };

/// A smooth random texture, defined everywhere: values on a lattice of 5 px and one of 11 px, blended by cosines.
fn texture(x: f32, y: f32) -> f32 {
    128.0 + 70.0 * noise(x / 5.0, y / 5.0, 1) + 50.0 * noise(x / 11.0, y / 11.0, 2)
}

fn noise(x: f32, y: f32, seed: u64) -> f32 {
    let blend = |t: f32| 0.5 - 0.5 * (std::f32::consts::PI * (t - t.floor())).cos();
    let (i, j) = (x.floor() as i64, y.floor() as i64);
    let row = |j: i64| {
        let (a, b) = (lattice(i, j, seed), lattice(i + 1, j, seed));
        a + (b - a) * blend(x)
    };
    row(j) + (row(j + 1) - row(j)) * blend(y)
}

/// A number in -1..1 from the coordinates (SplitMix64's mixer).
fn lattice(i: i64, j: i64, seed: u64) -> f32 {
    let mut z = (i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (j as u64).rotate_left(32) ^ (seed << 17);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 40) as f32 / (1_u64 << 23) as f32 - 1.0
}

fn picture(value: impl Fn(f32, f32) -> f32) -> ImageRgb8 {
    let at = |i: usize| value((i % SIZE.width) as f32 + 0.5, (i / SIZE.width) as f32 + 0.5);
    let data = (0..SIZE.pixels()).flat_map(|i| [at(i).clamp(0.0, 255.0).round() as u8; 3]).collect();
    ImageRgb8::new(SIZE, data).unwrap()
}

fn errors(tracks: &TrackSet, truth: impl Fn([f32; 2]) -> [f32; 2]) -> Vec<f32> {
    let error = |(s, t): (&[f32; 2], &[f32; 2])| {
        let wanted = truth(*s);
        (t[0] - wanted[0]).hypot(t[1] - wanted[1])
    };
    let mut all: Vec<f32> = tracks.src.iter().zip(&tracks.tgt).map(error).collect();
    all.sort_by(f32::total_cmp);
    all
}

fn tracked(before: &ImageRgb8, after: &ImageRgb8, interest: Option<&Mask>) -> (TrackSet, TrackSet) {
    let config = TrackerConfig::default();
    let (a, b) = (Frame::new(before, interest, &config), Frame::new(after, interest, &config));
    let sparse = matches(&a, &b, &config);
    let medium = lucas_kanade(&a, &b, &sparse, &config);
    (sparse, medium)
}

#[test]
fn a_turn_with_another_exposure_is_followed_to_a_fraction_of_a_pixel() {
    let (sine, cosine) = 0.03_f32.sin_cos();
    let forward = |[x, y]: [f32; 2]| {
        let (u, v) = (x - 160.0, y - 90.0);
        [160.0 + cosine * u - sine * v + 6.3, 90.0 + sine * u + cosine * v - 3.7]
    };
    let backward = |x: f32, y: f32| {
        let (u, v) = (x - 166.3, y - 86.3);
        texture(160.0 + cosine * u + sine * v, 90.0 - sine * u + cosine * v)
    };
    let (before, after) = (picture(texture), picture(|x, y| 0.85 * backward(x, y) + 12.0));
    let (sparse, medium) = tracked(&before, &after, None);
    for (tracks, least) in [(sparse, 300), (medium, 2000)] {
        let errors = errors(&tracks, forward);
        assert!(errors.len() > least, "{}", errors.len());
        let (median, high) = (errors[errors.len() / 2], errors[errors.len() * 95 / 100]);
        assert!(median < 0.15 && high < 0.6, "{median} {high}");
    }
}

#[test]
fn a_small_fast_thing_before_a_still_background_is_followed() {
    let (dx, dy) = (41.0, 7.0);
    let inside = |x: f32, y: f32| (60.0..100.0).contains(&x) && (70.0..100.0).contains(&y);
    let scene = |sx: f32, sy: f32| {
        picture(
            move |x, y| {
                if inside(x - sx, y - sy) { texture(x - sx + 500.0, y - sy) } else { texture(x, y) }
            },
        )
    };
    let mask = Mask::new(
        SIZE,
        (0..SIZE.pixels()).map(|i| u8::from(inside((i % 320) as f32, (i / 320) as f32))).collect(),
    );
    let (_, medium) = tracked(&scene(0.0, 0.0), &scene(dx, dy), mask.as_ref());
    let core = |p: &[f32; 2]| (68.0..92.0).contains(&p[0]) && (78.0..92.0).contains(&p[1]);
    let on_it: Vec<usize> = (0..medium.src.len()).filter(|&i| core(&medium.src[i])).collect();
    let right = on_it.iter().filter(|&&i| {
        (medium.tgt[i][0] - medium.src[i][0] - dx).hypot(medium.tgt[i][1] - medium.src[i][1] - dy) < 0.5
    });
    let (right, all) = (right.count(), on_it.len());
    assert!(all >= 20 && right * 10 >= all * 9, "{right} of {all}");
}

#[test]
fn noise_that_does_not_move_gives_no_false_tracks() {
    // Another picture: what is found comes back to its start by chance only.
    let other = picture(|x, y| texture(x + 3000.0, y - 2000.0));
    let (sparse, medium) = tracked(&picture(texture), &other, None);
    assert!(sparse.src.len() < 20 && medium.src.len() < 250, "{} {}", sparse.src.len(), medium.src.len());
}

#[test]
fn a_blank_picture_has_no_tracks() {
    let blank = picture(|_, _| 90.0);
    let (sparse, medium) = tracked(&blank, &blank, None);
    assert!(sparse.src.is_empty() && medium.src.is_empty());
}

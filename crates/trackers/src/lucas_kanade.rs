//! Lucas and Kanade's tracker on pyramids (Bouguet, "Pyramidal implementation of the Lucas Kanade feature tracker",
//! 2000), with the mean of every window taken out, so that a change of exposure is no motion.

use crate::corners::smaller_eigenvalue;
use crate::pyramid::{Level, PAD, Pyramid};

/// Half the side of the window.
const RADIUS: usize = 7;
const SIDE: usize = 2 * RADIUS + 1;
const ITERATIONS: usize = 20;
/// A step below this (px) ends the iterations: a hundredth of a good tracker's noise is not worth more.
const CONVERGED: f32 = 0.01;
/// Smaller eigenvalue per pixel below which a window has no texture in some direction.
const LEAST_EIGENVALUE: f32 = 0.5;

type Patch = [f32; SIDE * SIDE];

/// Where the content of `prev` around `at` lies in `next`, with the correlation of the two windows (1 = equal up to
/// exposure). Without a guess of the displacement all levels are searched; a guess is refined on the finest two, because
/// a small thing is lost in the coarse ones. `None` when the window has no texture or leaves the picture.
pub(crate) fn track(
    prev: &Pyramid,
    next: &Pyramid,
    at: [f32; 2],
    guess: Option<[f32; 2]>,
) -> Option<([f32; 2], f32)> {
    let highest = if guess.is_some() { 1 } else { usize::MAX };
    let top = highest.min(prev.levels.len() - 1).min(next.levels.len() - 1);
    let scale = |level: usize| 1.0 / (1_u32 << level) as f32;
    let mut d = guess.unwrap_or_default().map(|v| v * scale(top));
    let mut correlation = 0.0;
    for level in (0..=top).rev() {
        let p = at.map(|v| v * scale(level));
        match follow(&prev.levels[level], &next.levels[level], p, d) {
            Some((found, c)) => (d, correlation) = (found, c),
            // A coarse level may be blank where a finer one has texture.
            None if level > 0 => {}
            None => return None,
        }
        if level > 0 {
            d = d.map(|v| v * 2.0);
        }
    }
    Some(([at[0] + d[0], at[1] + d[1]], correlation))
}

/// One level: the displacement, and the correlation.
fn follow(prev: &Level, next: &Level, p: [f32; 2], mut d: [f32; 2]) -> Option<([f32; 2], f32)> {
    let (mut template, mut dx, mut dy) = ([0.0; SIDE * SIDE], [0.0; SIDE * SIDE], [0.0; SIDE * SIDE]);
    sample(prev, &prev.grey, p, &mut template)?;
    sample(prev, &prev.dx, p, &mut dx)?;
    sample(prev, &prev.dy, p, &mut dy)?;
    [&mut template, &mut dx, &mut dy].into_iter().for_each(centre);
    let (a, b, c) = (dot(&dx, &dx), dot(&dx, &dy), dot(&dy, &dy));
    if !(smaller_eigenvalue([a, b, c]) > LEAST_EIGENVALUE * (SIDE * SIDE) as f32) {
        return None;
    }
    let inverse = 1.0 / (a * c - b * b);
    let mut window = [0.0; SIDE * SIDE];
    for _ in 0..ITERATIONS {
        sample(next, &next.grey, [p[0] + d[0], p[1] + d[1]], &mut window)?;
        centre(&mut window);
        window.iter_mut().zip(&template).for_each(|(w, t)| *w = t - *w);
        let (u, v) = (dot(&window, &dx), dot(&window, &dy));
        let step = [(c * u - b * v) * inverse, (a * v - b * u) * inverse];
        d = [d[0] + step[0], d[1] + step[1]];
        if step[0].abs().max(step[1].abs()) < CONVERGED {
            break;
        }
    }
    sample(next, &next.grey, [p[0] + d[0], p[1] + d[1]], &mut window)?;
    centre(&mut window);
    let energy = (dot(&template, &template) * dot(&window, &window)).sqrt();
    Some((d, dot(&template, &window) / energy.max(f32::MIN_POSITIVE)))
}

/// The bilinear window around `p`; `None` when its centre lies outside the picture.
fn sample(level: &Level, plane: &[f32], p: [f32; 2], out: &mut Patch) -> Option<()> {
    const { assert!(RADIUS + 2 <= PAD) };
    let inside = |v: f32, n: usize| v >= 0.0 && v <= n as f32;
    if !(inside(p[0], level.size.width) && inside(p[1], level.size.height)) {
        return None;
    }
    let (x, y) = (p[0] - 0.5 - RADIUS as f32, p[1] - 0.5 - RADIUS as f32);
    let (left, top) = (x.floor(), y.floor());
    let (u, v) = (x - left, y - top);
    let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
    let start = level.index(left as isize, top as isize);
    for (j, row) in out.chunks_exact_mut(SIDE).enumerate() {
        let above = &plane[start + j * level.stride()..][..=SIDE];
        let below = &plane[start + (j + 1) * level.stride()..][..=SIDE];
        for (i, value) in row.iter_mut().enumerate() {
            *value = weights[0] * above[i]
                + weights[1] * above[i + 1]
                + weights[2] * below[i]
                + weights[3] * below[i + 1];
        }
    }
    Some(())
}

fn centre(patch: &mut Patch) {
    let mean = patch.iter().sum::<f32>() / (SIDE * SIDE) as f32;
    patch.iter_mut().for_each(|v| *v -= mean);
}

/// In a fixed order of eight partial sums, which the compiler can keep in one register.
fn dot(a: &Patch, b: &Patch) -> f32 {
    let mut sums = [0.0_f32; 8];
    for (x, y) in a.chunks(8).zip(b.chunks(8)) {
        for (s, (x, y)) in sums.iter_mut().zip(x.iter().zip(y)) {
            *s += x * y;
        }
    }
    sums.iter().sum()
}

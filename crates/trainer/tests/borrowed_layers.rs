//! What a frame learns about the moving layer is computed over borrowed layers. A process of its own, as memory is measured.

use ffgs_core::{Camera, Gaussians, ImageRgb8, ImageSize, Intrinsics, Mask, SkyCube, TrainingView};
use ffgs_trainer::information_gain;
use std::fs;

/// Peak of the process's resident memory so far (bytes).
fn peak() -> usize {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    1024 * line.trim().trim_end_matches(" kB").parse::<usize>().unwrap()
}

fn view() -> TrainingView {
    let size = ImageSize { width: 48, height: 32 };
    let intrinsics = Intrinsics { fx: 40.0, fy: 40.0, cx: 24.0, cy: 16.0 };
    TrainingView {
        camera: Camera::new(intrinsics, glam::DMat4::IDENTITY, size).unwrap(),
        image: ImageRgb8::new(size, vec![90; 3 * size.pixels()]).unwrap(),
        mask: Mask::filled(size, true),
    }
}

/// `n` Gaussians of SH degree 3 at a depth (m).
fn layer(n: usize, depth: f32) -> Gaussians {
    let mut layer = Gaussians::zeros(n, 3);
    layer.means.fill([0.0, 0.0, depth]);
    layer.quats.fill([1.0, 0.0, 0.0, 0.0]);
    layer.log_scales.fill([-2.0; 3]);
    layer.sh.as_flattened_mut().fill(0.1);
    layer
}

/// Peak memory rises by less than a tenth of what one copy of the static layer takes, and rises when one is made.
#[test]
#[cfg_attr(not(target_os = "linux"), ignore = "reads /proc")]
fn the_static_layer_is_not_copied() {
    const STILL: usize = 500_000;
    let still = layer(STILL, -3.0);
    let moving = layer(40, 3.0);
    let (sky, views) = (SkyCube::filled(4, [0.5; 3]), [view(), view(), view()]);
    let bytes = STILL * size_of::<[f32; 3 + 4 + 3 + 1 + 48]>();
    let before = peak();
    let gain = information_gain(&[&still, &moving], &sky, &views);
    let grown = peak() - before;
    assert!(gain.information.positions[0].x_axis.x > 0.0, "nothing was seen");
    assert!(grown < bytes / 10, "{grown} bytes beside a layer of {bytes}");
    // The measurement sees a copy.
    let copy = still.clone();
    assert!(peak() - before > bytes * 9 / 10 && copy.len() == STILL);
}

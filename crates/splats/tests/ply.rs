//! Splat PLY: round trips, foreign files, hostile files.

use ffgs_core::{Gaussians, sh_coefficients};
use ffgs_splats::{Followed, Problem, read_ply, write_ply};
use glam::{DMat3, DVec3};
use std::fmt::Write as _;
use std::fs;
use std::path::PathBuf;

fn some_gaussians(n: usize, degree: usize) -> Gaussians {
    let mut counter = 0.0f32;
    let mut next = || {
        counter += 0.37;
        counter.sin() * 3.0
    };
    let mut g = Gaussians::zeros(n, degree);
    g.means.as_flattened_mut().iter_mut().for_each(|v| *v = next());
    g.quats.as_flattened_mut().iter_mut().for_each(|v| *v = next());
    g.log_scales.as_flattened_mut().iter_mut().for_each(|v| *v = next());
    g.opacity_logits.iter_mut().for_each(|v| *v = next());
    g.sh.as_flattened_mut().iter_mut().for_each(|v| *v = next());
    assert_eq!(g.sh.len(), n * sh_coefficients(degree));
    g
}

struct Scratch(tempfile::TempDir);

impl Scratch {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self) -> PathBuf {
        self.0.path().join("x.ply")
    }

    fn problem_with(&self, bytes: &[u8]) -> String {
        fs::write(self.path(), bytes).unwrap();
        let error = read_ply(&self.path()).unwrap_err().to_string();
        assert!(error.contains("x.ply"), "{error}");
        error
    }
}

#[test]
fn every_degree_survives_a_round_trip() {
    let scratch = Scratch::new();
    for degree in 0..=3 {
        let g = some_gaussians(7, degree);
        write_ply(&scratch.path(), &g, None).unwrap();
        let back = read_ply(&scratch.path()).unwrap();
        assert_eq!((back.gaussians, back.covariances), (g, None));
    }
}

#[test]
fn covariances_and_ids_survive_and_an_empty_set_is_a_file() {
    let scratch = Scratch::new();
    let m = DMat3::from_cols(
        DVec3::new(1.0, 0.5, 0.25),
        DVec3::new(0.5, 2.0, 0.125),
        DVec3::new(0.25, 0.125, 3.0),
    );
    let tracked = Followed { covariances: &[m, m * 2.0], ids: &[7, u32::MAX] };
    write_ply(&scratch.path(), &some_gaussians(2, 1), Some(tracked)).unwrap();
    let back = read_ply(&scratch.path()).unwrap();
    assert_eq!(back.covariances.unwrap(), [m, m * 2.0]);
    assert_eq!(back.ids.unwrap(), [7, u32::MAX]);
    let none = Followed { covariances: &[], ids: &[] };
    write_ply(&scratch.path(), &Gaussians::empty(3), Some(none)).unwrap();
    assert!(read_ply(&scratch.path()).unwrap().gaussians.is_empty());
    let error =
        write_ply(&scratch.path(), &some_gaussians(2, 1), Some(Followed { covariances: &[m], ids: &[1] }))
            .unwrap_err();
    assert!(matches!(error.problem, Problem::Shape(_)));
}

#[test]
fn f_rest_is_channel_major() {
    let scratch = Scratch::new();
    let mut g = Gaussians::zeros(1, 1);
    for k in 0..4 {
        g.sh[k] = [k as f32, 10.0 + k as f32, 20.0 + k as f32];
    }
    write_ply(&scratch.path(), &g, None).unwrap();
    let bytes = fs::read(scratch.path()).unwrap();
    let body = &bytes[bytes.len() - 26 * 4..];
    let row: Vec<f32> = body.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!(row[6..18], [0., 10., 20., 1., 2., 3., 11., 12., 13., 21., 22., 23.]);
}

/// An ascii file of degree 0 with a comment, an unknown property, a list and an element in front.
fn foreign() -> String {
    let mut text = String::from("ply\r\nformat ascii 1.0\r\ncomment made elsewhere\r\nelement camera 1\r\n");
    text += "property list uchar int ids\r\nelement vertex 2\r\nproperty list uchar int neighbours\r\n";
    let names =
        "z x y f_dc_0 f_dc_1 f_dc_2 confidence opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    for name in names.split(' ') {
        write!(text, "property double {name}\r\n").unwrap();
    }
    text += "end_header\r\n3 1 2 3\r\n0 3 1 2 4 5 6 99 7 8 9 10 1 0 0 0\r\n";
    text + "2 8 9 3 1 2 4 5 6 nan 7 8 9 10 1 0 0 0"
}

#[test]
fn a_foreign_ascii_file_is_read() {
    let scratch = Scratch::new();
    fs::write(scratch.path(), foreign()).unwrap();
    let g = read_ply(&scratch.path()).unwrap().gaussians;
    assert_eq!(g.means, [[1.0, 2.0, 3.0]; 2]);
    assert_eq!((g.sh_degree(), g.opacity_logits.as_slice()), (0, &[7.0f32, 7.0][..]));
}

#[test]
fn hostile_files_are_errors_that_name_the_file() {
    let scratch = Scratch::new();
    assert!(scratch.problem_with(b"").contains("end_header"));
    assert!(scratch.problem_with(b"plx\n").contains("`ply`"));
    assert!(scratch.problem_with(&vec![b'x'; 200_000]).contains("end_header"));
    let huge = foreign().replace("vertex 2", "vertex 99999999999999");
    assert!(scratch.problem_with(huge.as_bytes()).contains("truncated"));
    assert!(scratch.problem_with(foreign().replace("opacity", "o").as_bytes()).contains("`opacity`"));
    assert!(scratch.problem_with(foreign().replace("99", "what").as_bytes()).contains("`what`"));
    assert!(scratch.problem_with(foreign().replace("6 nan 7", "6 1 inf").as_bytes()).contains("not finite"));
    let no_columns = b"ply\nformat ascii 1.0\nelement a 18446744073709551615\nelement vertex 0\nend_header\n";
    assert!(scratch.problem_with(no_columns).contains("no properties"));
    assert!(read_ply(&scratch.0.path().join("absent.ply")).unwrap_err().to_string().contains("absent.ply"));
}

#[test]
fn every_truncation_is_an_error() {
    let scratch = Scratch::new();
    write_ply(&scratch.path(), &some_gaussians(2, 0), None).unwrap();
    let bytes = fs::read(scratch.path()).unwrap();
    for length in 0..bytes.len() {
        scratch.problem_with(&bytes[..length]);
    }
}

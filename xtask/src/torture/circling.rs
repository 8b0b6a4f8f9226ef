//! A capture of any length whose pictures, masks, points and motion are computed: a disc that circles before a wall, seen by
//! cameras side by side. Small, so that a run of hundreds of frames takes a minute.

use super::checksum::crc32;
use anyhow::{Context, Result};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

/// Frames of one turn; after it the pictures repeat.
const TURN: usize = 30;
/// Pixels of an image.
const SIZE: [usize; 2] = [64, 48];
/// Focal length (px).
const FOCAL: f64 = 60.0;
/// Where the cameras stand (m); all look along the z axis. The last is the test view.
const CAMERAS: [[f64; 2]; 4] = [[-1.0, 0.0], [1.0, 0.2], [0.0, -0.8], [0.3, 0.3]];
/// Distance of the disc, of its path's radius, of its own, and of the wall behind it (m).
const DISC_Z: f64 = 4.0;
const PATH: f64 = 0.6;
const RADIUS: f64 = 0.5;
const WALL_Z: f64 = 6.0;
/// Initial points on the disc and on the wall, on each side of a square.
const DISC_POINTS: usize = 10;
const WALL_POINTS: usize = 16;

/// Writes the capture into `to`.
pub(crate) fn write(to: &Path, frames: usize) -> Result<()> {
    let cameras: Vec<usize> = (0..CAMERAS.len()).collect();
    let (test, train) = cameras.split_last().context("no camera")?;
    put(&to.join("train_meta.json"), list(train, frames).to_string().as_bytes())?;
    put(&to.join("test_meta.json"), list(&[*test], frames).to_string().as_bytes())?;
    let tracker = |name: &str| json!({"name": name, "level": "dense", "format": "flo", "pattern": "{camera}/{stem}.flo", "pixel_center": "half"});
    put(
        &to.join("tracks/tracks.json"),
        json!({"trackers": [tracker("one"), tracker("other")]}).to_string().as_bytes(),
    )?;
    put(&to.join("init_pt_cld.npz"), &npz("data", &points()))?;
    for (camera, turn) in cameras.iter().flat_map(|camera| (0..TURN).map(move |turn| (*camera, turn))) {
        let [image, mask] = pictures(camera, turn);
        put(&to.join(format!("ims/{camera}/{turn}.png")), &png(&image))?;
        put(&to.join(format!("seg/{camera}/{turn}.png")), &png(&mask))?;
        put(&to.join(format!("tracks/{camera}/{turn}.flo")), &flow(camera, turn))?;
    }
    Ok(())
}

fn put(file: &Path, bytes: &[u8]) -> Result<()> {
    fs::create_dir_all(file.parent().context("no folder")?)?;
    fs::write(file, bytes).with_context(|| format!("cannot write {}", file.display()))
}

/// A camera list.
fn list(cameras: &[usize], frames: usize) -> Value {
    let [width, height] = SIZE;
    let k = json!([[FOCAL, 0.0, width as f64 / 2.0], [0.0, FOCAL, height as f64 / 2.0], [0.0, 0.0, 1.0]]);
    let pose = |c: &usize| {
        let [x, y] = CAMERAS[*c];
        json!([[1.0, 0.0, 0.0, -x], [0.0, 1.0, 0.0, -y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    };
    let row = |of: &dyn Fn(&usize) -> Value| Value::from(cameras.iter().map(of).collect::<Vec<_>>());
    let rows = |of: &dyn Fn(usize) -> Value| Value::from((0..frames).map(of).collect::<Vec<_>>());
    json!({
        "w": width, "h": height,
        "k": rows(&|_| row(&|_| k.clone())),
        "w2c": rows(&|_| row(&pose)),
        "fn": rows(&|t| row(&|c| json!(format!("{c}/{}.png", t % TURN)))),
        "cam_id": rows(&|_| row(&|c| json!(c))),
    })
}

/// Centre of the disc (m).
fn centre(turn: usize) -> [f64; 2] {
    let angle = std::f64::consts::TAU * turn as f64 / TURN as f64;
    [PATH * angle.cos(), PATH * angle.sin()]
}

/// A colour that changes smoothly with the place (m).
fn colour([x, y]: [f64; 2], scale: f64) -> [u8; 3] {
    let wave = |phase: f64| 127.5 + 60.0 * (scale * x + phase).sin() + 60.0 * (scale * y - phase).cos();
    [0.0, 2.0, 4.0].map(|phase| wave(phase) as u8)
}

/// What a camera sees at a depth in each of its pixels, row after row: the place (m).
fn places(camera: usize, depth: f64) -> impl Iterator<Item = [f64; 2]> {
    let [width, height] = SIZE;
    let along = move |pixel: usize, pixels: usize| (pixel as f64 + 0.5 - pixels as f64 / 2.0) * depth / FOCAL;
    let [x, y] = CAMERAS[camera];
    (0..width * height).map(move |i| [x + along(i % width, width), y + along(i / width, height)])
}

/// The place relative to the disc's centre, where it is on the disc.
fn on_disc([x, y]: [f64; 2], turn: usize) -> Option<[f64; 2]> {
    let [cx, cy] = centre(turn);
    let place = [x - cx, y - cy];
    (place[0].hypot(place[1]) < RADIUS).then_some(place)
}

/// Image and mask, RGB.
fn pictures(camera: usize, turn: usize) -> [Vec<u8>; 2] {
    let seen = || places(camera, DISC_Z).map(|place| on_disc(place, turn));
    let image = seen().zip(places(camera, WALL_Z));
    let image =
        image.flat_map(|(disc, wall)| disc.map_or_else(|| colour(wall, 2.0), |place| colour(place, 9.0)));
    [image.collect(), seen().flat_map(|disc| [u8::from(disc.is_some()) * 255; 3]).collect()]
}

/// Optical flow (px) from the picture before, as Middlebury's `.flo`: that of the disc, and none of the wall.
fn flow(camera: usize, turn: usize) -> Vec<u8> {
    let before = (turn + TURN - 1) % TURN;
    let (from, to) = (centre(before), centre(turn));
    let step = [0, 1].map(|axis| ((to[axis] - from[axis]) * FOCAL / DISC_Z) as f32);
    let moves = places(camera, DISC_Z).map(|place| on_disc(place, before).map_or([0.0; 2], |_| step));
    let size = SIZE.map(|side| (side as u32).to_le_bytes());
    let head = [b"PIEH".as_slice(), &size[0], &size[1]].concat();
    head.into_iter().chain(moves.flatten().flat_map(f32::to_le_bytes)).collect()
}

/// Rows x, y, z (m), red, green, blue (0 to 1), foreground.
fn points() -> Vec<[f64; 7]> {
    let grid = |count: usize, half: f64| {
        let along = move |i: usize| half * ((2 * i + 1) as f64 / count as f64 - 1.0);
        (0..count * count).map(move |i| [along(i % count), along(i / count)])
    };
    let row = |[x, y]: [f64; 2], z: f64, rgb: [u8; 3], foreground: f64| {
        let [r, g, b] = rgb.map(|value| f64::from(value) / 255.0);
        [x, y, z, r, g, b, foreground]
    };
    let [cx, cy] = centre(0);
    let disc = grid(DISC_POINTS, RADIUS).filter(|place| place[0].hypot(place[1]) < RADIUS);
    let disc = disc.map(|p| row([p[0] + cx, p[1] + cy], DISC_Z, colour(p, 9.0), 1.0));
    disc.chain(grid(WALL_POINTS, 4.0).map(|p| row(p, WALL_Z, colour(p, 2.0), 0.0))).collect()
}

/// An RGB image as a PNG that does not compress.
fn png(rgb: &[u8]) -> Vec<u8> {
    let [width, height] = SIZE;
    let rows: Vec<u8> =
        rgb.chunks(3 * width).flat_map(|row| std::iter::once(&0).chain(row)).copied().collect();
    let sum = rows.iter().fold([1_u32, 0], |[a, b], byte| {
        let a = (a + u32::from(*byte)) % 65521;
        [a, (b + a) % 65521]
    });
    let length = rows.len() as u16;
    let adler = (sum[1] << 16 | sum[0]).to_be_bytes();
    let block = [&length.to_le_bytes()[..], &(!length).to_le_bytes(), &rows, &adler].concat();
    let chunk = |name: &[u8], bytes: &[u8]| {
        let named = [name, bytes].concat();
        [&(bytes.len() as u32).to_be_bytes()[..], &named, &crc32(&named).to_be_bytes()].concat()
    };
    let size = [(width as u32).to_be_bytes(), (height as u32).to_be_bytes()].concat();
    let head = chunk(b"IHDR", &[&size[..], &[8, 2, 0, 0, 0]].concat());
    let data = chunk(b"IDAT", &[&[0x78, 0x01, 0x01][..], &block].concat());
    [b"\x89PNG\r\n\x1a\n".as_slice(), &head, &data, &chunk(b"IEND", b"")].concat()
}

/// An archive with one array that is stored as it is.
fn npz(name: &str, rows: &[[f64; 7]]) -> Vec<u8> {
    let text = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, 7), }}\n", rows.len());
    let values: Vec<u8> = rows.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
    let array =
        [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes(), &values].concat();
    let name = format!("{name}.npy");
    let [length, sum] = [array.len() as u32, crc32(&array)].map(u32::to_le_bytes);
    let entry = [&sum[..], &length, &length, &(name.len() as u16).to_le_bytes(), &[0; 2]].concat();
    let local = [b"PK\x03\x04\x14\0\0\0\0\0\0\0\0\0", &entry[..], name.as_bytes(), &array].concat();
    let central = [b"PK\x01\x02\x14\0\x14\0\0\0\0\0\0\0\0\0", &entry[..], &[0; 14], name.as_bytes()].concat();
    let places = [central.len() as u32, local.len() as u32].map(u32::to_le_bytes).concat();
    [&local[..], &central, b"PK\x05\x06\0\0\0\0\x01\0\x01\0", &places, &[0; 2]].concat()
}

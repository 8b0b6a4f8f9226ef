//! Everything that costs time on the CPU: `cargo xtask bench` runs this and compares it with the machine's own rates.

mod lanes;
mod machine;
mod parts;
mod raster;
mod scene;

use criterion::{Criterion, criterion_group, criterion_main};
use std::time::Duration;

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2));
    targets = machine::rates, parts::loss, parts::adam, raster::sizes, raster::garden, lanes::dynamic, lanes::static_lane
}
criterion_main!(benches);

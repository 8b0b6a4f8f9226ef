//! How time and peak memory grow with Gaussians, pixels, views and foreground share: `cargo xtask bench --scaling`.
//!
//! Every case runs in a process of its own, so that the peak is that case's alone; the parent prints one CSV row a
//! case. `held` is what the method cannot do without, by the formulas of [`held`].

#[allow(dead_code, reason = "the other benchmark uses the rest")]
#[path = "../cpu/scene.rs"]
mod scene;

mod cases;
mod held;
mod memory;

use cases::{Case, all};
use std::process::Command;

const HEADER: &str =
    "lane,gaussians,width,height,views,foreground,threads,setup_s,step_ms,peak_mib,held_mib,ratio";

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    match arguments.as_slice() {
        [flag, name] if flag == "--case" => match all().iter().find(|c| c.to_string() == *name) {
            Some(case) => println!("{}", case.measure()),
            None => eprintln!("no case {name}"),
        },
        [] => parent(""),
        [filter, ..] => parent(filter),
    }
}

fn parent(filter: &str) {
    let Ok(program) = std::env::current_exe() else { return eprintln!("where is this program?") };
    println!("{HEADER}");
    for case in all().iter().map(Case::to_string).filter(|name| name.contains(filter)) {
        match Command::new(&program).args(["--case", &case]).output() {
            Ok(output) if output.status.success() => print!("{}", String::from_utf8_lossy(&output.stdout)),
            Ok(output) => eprintln!("{case}: {}", String::from_utf8_lossy(&output.stderr)),
            Err(error) => eprintln!("{case}: {error}"),
        }
    }
}

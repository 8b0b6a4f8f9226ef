//! A run as one splat file per frame, in any registered format.

use super::args::{ExportArgs, Layer};
use super::axes::{Axes, chosen, tell_of_thinned};
use crate::cli::terminal::{self, progress};
use crate::commands::export::bake::Baker;
use crate::commands::export::measure::{Measurement, Shown, measure, table};
use crate::outputs::finished_run::FinishedRun;
use crate::outputs::json::{read_json, write_json};
use anyhow::{Result, bail};
use ffgs_core::{Gaussians, Scene, spatial_order};
use ffgs_method::{SplatWriter, Splats};
use ffgs_splats::write_sky_equirectangular;
use serde::{Deserialize, Serialize};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

/// What is written when nothing else is asked for.
const LAYERS: [Layer; 3] = [Layer::Static, Layer::Dynamic, Layer::Sky];
/// With which ADR 23 measured what plain viewers lose.
const BAKE_ITERATIONS: usize = 2000;

/// `export.json`: what the files of a folder are.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Description {
    format: String,
    /// Name of the capture.
    capture: String,
    layers: Vec<Layer>,
    /// Whether ordinary viewers show the files as the run was trained.
    baked: bool,
    bake_iterations: usize,
    /// First frame, from which the static layer is baked.
    first: usize,
    /// The sky's top row looks along this, unit, world axes.
    up: [f32; 3],
    /// The sky's middle column looks along this.
    forward: [f32; 3],
}

pub(super) fn export_files(args: &ExportArgs, format: &'static dyn SplatWriter, out: PathBuf) -> Result<()> {
    let run = FinishedRun::open(&args.run)?;
    let frames = chosen(&run, args.frames)?;
    tell_of_thinned(&run, args.frames);
    let axes = Axes::of(&*run.capture, frames[0])?;
    let description = Description {
        format: format.name().to_owned(),
        capture: run.manifest.capture.clone(),
        layers: args.layers.clone().unwrap_or_else(|| LAYERS.to_vec()),
        baked: !args.native,
        bake_iterations: args.bake_iterations.unwrap_or(BAKE_ITERATIONS),
        first: frames[0],
        up: axes.up.to_array(),
        forward: axes.forward.to_array(),
    };
    claim(&out, &description)?;
    let export = Export { args, description, run, format, out, axes };
    let measured = export.frames(&frames)?;
    if args.measure {
        terminal::print(table(&measured).trim_end());
        write_json(&export.out.join("measure.json"), &measured)?;
    }
    terminal::print(export.out.display());
    Ok(())
}

/// Takes the folder for this export: a new one, or one that the same export began.
fn claim(out: &Path, description: &Description) -> Result<()> {
    let file = out.join("export.json");
    if file.exists() && read_json::<Description>(&file)? != *description {
        bail!("{} holds another export; choose another --out or remove the folder", out.display());
    }
    write_json(&file, description)
}

struct Export<'a> {
    args: &'a ExportArgs,
    description: Description,
    run: FinishedRun,
    format: &'static dyn SplatWriter,
    out: PathBuf,
    axes: Axes,
}

impl Export<'_> {
    fn frames(&self, frames: &[usize]) -> Result<Vec<Measurement>> {
        let bar = progress(self.args.log.quiet, "frames", frames.len());
        let show = |text| bar.set_message(text);
        let mut baker = Baker::new(&self.run, frames[0], self.description.bake_iterations, &show);
        let mut measured = Vec::new();
        for &frame in frames {
            if self.args.measure || !self.is_written(frame) {
                let scene = self.run.scene(frame)?;
                let joint = if self.args.native { scene.joint() } else { baker.bake(&scene, frame)? };
                self.write(frame, &scene, &joint)?;
                if self.args.measure {
                    let path = self.splat_path(frame);
                    let read = self.as_read(&path, joint)?;
                    let shown = Shown { gaussians: &read, sky: None };
                    measured.push(measure(
                        (&*self.run.capture, &self.run.exposures(frame)?),
                        &scene,
                        &shown,
                        frame,
                    )?);
                }
            }
            bar.inc(1);
            if !self.args.log.quiet && !std::io::stderr().is_terminal() {
                terminal::note(format_args!("frame {frame}: {} of {}", bar.position(), frames.len()));
            }
        }
        bar.finish_and_clear();
        Ok(measured)
    }

    fn has(&self, layer: Layer) -> bool {
        self.description.layers.contains(&layer)
    }

    fn splat_path(&self, frame: usize) -> PathBuf {
        let stem = match (self.has(Layer::Static), self.has(Layer::Dynamic)) {
            (true, false) => "static",
            (false, true) => "dynamic",
            _ => "frame",
        };
        self.out.join(format!("{stem}_{frame:04}{}", self.format.extension()))
    }

    fn sky_path(&self, frame: usize) -> PathBuf {
        self.out.join(format!("sky_{frame:04}.jpg"))
    }

    fn has_splats(&self) -> bool {
        self.has(Layer::Static) || self.has(Layer::Dynamic)
    }

    fn is_written(&self, frame: usize) -> bool {
        (!self.has_splats() || self.splat_path(frame).exists())
            && (!self.has(Layer::Sky) || self.sky_path(frame).exists())
    }

    /// `joint`: the static layer, then the dynamic one.
    fn write(&self, frame: usize, scene: &Scene, joint: &Gaussians) -> Result<()> {
        if self.has_splats() {
            let chosen = self.in_layers(joint, scene.static_layer.len());
            self.format.write(&self.splat_path(frame), &Splats::from(&chosen))?;
        }
        if self.has(Layer::Sky) {
            let (size, texels) = (scene.sky.face_size(), scene.sky.texels.as_flattened());
            write_sky_equirectangular(&self.sky_path(frame), size, texels, self.axes.up, self.axes.forward)?;
        }
        Ok(())
    }

    /// The Gaussians of the chosen layers in spatial order, which compresses best.
    fn in_layers(&self, joint: &Gaussians, statics: usize) -> Gaussians {
        let part = |i: &usize| self.has(if *i < statics { Layer::Static } else { Layer::Dynamic });
        let order: Vec<usize> = spatial_order(&joint.means).into_iter().filter(part).collect();
        joint.select(&order)
    }

    /// What a player reads, where we can read the format and both layers are in the file; else what was written.
    fn as_read(&self, path: &Path, joint: Gaussians) -> Result<Gaussians> {
        let whole = self.has(Layer::Static) && self.has(Layer::Dynamic);
        match self.format.read(path).filter(|_| whole) {
            Some(read) => Ok(read?),
            None => Ok(joint),
        }
    }
}

//! What a registered method is.

use crate::settings::config::Config;
use anyhow::Result;
use ffgs_method::{MotionMethod, Plugin, TrackSource};
use ffgs_rasterizer_gpu::SceneDevice;

/// What methods are built from.
#[derive(Clone, Copy)]
pub struct MethodContext<'a> {
    /// Every setting.
    pub config: &'a Config,
    /// The capture's trackers.
    pub tracks: &'a [Box<dyn TrackSource>],
    /// Where to compute; `None` = the CPU.
    pub gpu: Option<&'a SceneDevice>,
}

/// Makes a method from its context and argument (empty for one that takes none).
type Build = for<'a> fn(&MethodContext<'a>, &str) -> Result<Box<dyn MotionMethod + 'a>>;

/// A registered method.
pub struct Method {
    /// Its name, with `:` and what is to be given behind it, if anything.
    pub usage: &'static str,
    /// A name that it had before, still understood.
    pub former: Option<&'static str>,
    /// What it is, in one line.
    pub summary: &'static str,
    /// Makes one.
    pub build: Build,
}

impl Plugin for Method {
    fn name(&self) -> &'static str {
        self.usage.split(':').next().unwrap_or_default()
    }

    fn summary(&self) -> &'static str {
        self.summary
    }

    fn usage(&self) -> &'static str {
        self.usage
    }
}

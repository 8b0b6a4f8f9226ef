//! From the command line to a request.

use crate::cli::RunArgs;
use crate::config::Config;
use crate::run::RunRequest;
use anyhow::Result;
use ffgs_trainer::StaticMethod;

/// Merges the configuration file (or the defaults) with the options, which win.
pub fn from_args(args: &RunArgs) -> Result<RunRequest> {
    let mut config = args.config.as_deref().map_or_else(|| Ok(Config::default()), Config::read)?;
    config.seed = args.seed.unwrap_or(config.seed);
    config.first_frame.iterations = args.first_iterations.unwrap_or(config.first_frame.iterations);
    config.dynamic.iterations = args.iterations.unwrap_or(config.dynamic.iterations);
    if let Some(steps) = args.static_iterations {
        config.background.static_method = StaticMethod::Steps;
        config.background.static_iterations = steps;
    }
    config.validate()?;
    Ok(RunRequest {
        capture: args.capture.clone(),
        out: args.out.clone(),
        resume: args.resume,
        method: args.method.clone().unwrap_or_default(),
        frames: args.frames,
        train_views: args.train_views.clone(),
        first_frame: args.first_frame.clone(),
        device: args.device.clone(),
        quiet: args.log.quiet,
        config,
    })
}

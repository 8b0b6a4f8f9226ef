//! `ffgs export`: a finished run as files for players.

pub(crate) mod bake;
pub(crate) mod measure;

mod args;
pub(crate) mod axes;
mod files;
mod importance;
pub(crate) mod stream;

pub(crate) use args::ExportArgs;

use crate::outputs::folder::RunFolder;
use anyhow::Result;
use ffgs_splats::FORMATS;

/// Writes the export.
///
/// # Errors
/// When an option has no effect on the format, the run cannot be read, the folder holds another export, or a file cannot be written.
pub(crate) fn export(args: &ExportArgs) -> Result<()> {
    args.check()?;
    let out =
        args.out.clone().map_or_else(|| RunFolder(args.run.clone()).inside(&["export", &args.to]), Ok)?;
    if args.is_stream() {
        return stream::export_stream(args, &out);
    }
    files::export_files(args, FORMATS.find(&args.to)?, out)
}

//! The names of the stages of a frame, as logs, reports and benchmarks have them. A stage of one method alone is named where it is timed.

/// Reading of photographs, masks and tracks.
pub const LOAD: &str = "load";
/// The exposures of the cameras, from the first frame.
pub const EXPOSURES: &str = "exposures";
/// Which Gaussians move, by the masks of t-1.
pub const MARKING: &str = "marking";
/// Tracks to motion fields.
pub const VORONOI: &str = "voronoi";
/// Agreement of the trackers.
pub const AGREEMENT: &str = "agreement";
/// Gaussians to displaced projections.
pub const ASSOCIATION: &str = "association";
/// Displaced projections to positions.
pub const TRIANGULATION: &str = "triangulation";
/// Rigid groups aligned with the photographs.
pub const ALIGNMENT: &str = "alignment";
/// Positions of all trackers and the prior to a posterior.
pub const FUSION: &str = "fusion";
/// Positions against masks.
pub const VALIDATION: &str = "validation";
/// Removal of faded Gaussians, splits of uncertain ones.
pub const GROWTH: &str = "growth";
/// New Gaussians where masks are not explained.
pub const BIRTH: &str = "birth";
/// Finetuning of the dynamic layer.
pub const DYNAMIC: &str = "dynamic";
/// Finetuning of the static layer.
pub const STATIC: &str = "static";
/// Finetuning of the sky.
pub const SKY: &str = "sky";
/// Training of static Gaussians that come to light.
pub const DISOCCLUSION: &str = "disocclusion";
/// Information of the photographs on the dynamic layer.
pub const INFORMATION: &str = "information";
/// The whole frame without its measurements.
pub const WALL: &str = "wall";

//! Every default of the method, in one TOML file.

use crate::settings::config_ranges;
use anyhow::{Context, Result, ensure};
use ffgs_core::read_text;
use ffgs_fusion::{FusionConfig, GrowthConfig};
use ffgs_methods::MethodSettings;
use ffgs_motion::{AlignmentConfig, AssociationConfig, MarkingConfig, MotionConfig};
use ffgs_reconstruction::ReconstructionConfig;
use ffgs_trainer::{
    BackgroundConfig, BirthConfig, DisocclusionConfig, DynamicLaneConfig, FirstFrameConfig, ResolutionConfig,
    StaticMethod,
};
use ffgs_triangulation::TriangulationConfig;
use ffgs_voronoi::{AgreementConfig, VoronoiConfig};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Most bytes of a configuration file.
const MAX_BYTES: u64 = 1 << 20;

/// The configuration of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Seed of everything random.
    pub seed: u64,
    /// Edge of a sky cube face (px).
    pub sky_face_size: usize,
    /// Frame 0.
    pub first_frame: FirstFrameConfig,
    /// Which Gaussians are dynamic, and which of them stay valid.
    pub marking: MarkingConfig,
    /// Densification of tracks (Algorithm 2).
    pub voronoi: VoronoiConfig,
    /// Cross-level agreement.
    pub agreement: AgreementConfig,
    /// Gaussians to pixels.
    pub association: AssociationConfig,
    /// Rays to positions.
    pub triangulation: TriangulationConfig,
    /// Positions to a posterior.
    pub fusion: FusionConfig,
    /// Rigid groups aligned with the photographs.
    pub alignment: AlignmentConfig,
    /// Growth by uncertainty.
    pub densification: GrowthConfig,
    /// Moving Gaussians where masks are not explained.
    pub birth: BirthConfig,
    /// How large photographs are in the frames after the first.
    pub resolution: ResolutionConfig,
    /// Finetuning of the dynamic layer.
    pub dynamic: DynamicLaneConfig,
    /// Finetuning of the static layer and the sky.
    pub background: BackgroundConfig,
    /// Training of static Gaussians that come to light.
    pub disocclusion: DisocclusionConfig,
    /// The methods that train in their own way, a table each.
    pub method: MethodSettings,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 1,
            sky_face_size: 128,
            first_frame: FirstFrameConfig::default(),
            marking: MarkingConfig::default(),
            voronoi: VoronoiConfig::default(),
            agreement: AgreementConfig::default(),
            association: AssociationConfig::default(),
            triangulation: TriangulationConfig::default(),
            fusion: FusionConfig::default(),
            alignment: AlignmentConfig::default(),
            densification: GrowthConfig::default(),
            birth: BirthConfig::default(),
            resolution: ResolutionConfig::default(),
            dynamic: DynamicLaneConfig::default(),
            background: BackgroundConfig::default(),
            disocclusion: DisocclusionConfig::default(),
            method: MethodSettings::default(),
        }
    }
}

impl Config {
    /// Reads a TOML file; keys that it leaves out keep their defaults, unknown keys are errors.
    ///
    /// # Errors
    /// When the file cannot be read, is no TOML, or has an unknown key or a value out of its range.
    pub fn read(path: &Path) -> Result<Self> {
        let text = read_text(path, MAX_BYTES).with_context(|| format!("cannot read {}", path.display()))?;
        let named =
            || format!("{} is not a valid configuration; `ffgs config` prints every key", path.display());
        let config: Self = toml::from_str(&text).with_context(named)?;
        config.validate().with_context(named)?;
        Ok(config)
    }

    /// Refuses settings outside their ranges, all of them in one message.
    ///
    /// # Errors
    /// When a value is out of its range; the error names its key.
    pub fn validate(&self) -> Result<()> {
        let faults = config_ranges::faults(self);
        ensure!(faults.is_empty(), "{}", faults.join("; "));
        Ok(())
    }

    /// The defaults with our most literal reading of the paper's motion initialisation (Algorithms 1 and 2), and training as it is
    /// printed: the dynamic layer on the masks alone, without a prior; plain steps on the static layer's colours, whose shape stays.
    pub fn literal() -> Self {
        let defaults = Self::default();
        Self {
            first_frame: FirstFrameConfig { exposures: false, ..defaults.first_frame },
            birth: BirthConfig { iterations: 0, ..defaults.birth },
            disocclusion: DisocclusionConfig { continued: false, iterations: 0, ..defaults.disocclusion },
            resolution: ResolutionConfig { splat_px: 0.0, static_splat_px: 0.0 },
            dynamic: DynamicLaneConfig {
                iterations: 300,
                natural_step: 0.0,
                loss_dilation: 0,
                outside_alpha: 0.0,
                prior_weight: 0.0,
                ..defaults.dynamic
            },
            background: BackgroundConfig {
                static_method: StaticMethod::Steps,
                exposure_change: 0.0,
                ..defaults.background
            },
            ..defaults
        }
        .with_motion(&MotionConfig::literal())
    }

    /// [`literal`](Self::literal), and word for word where that leaves no method: V counts the views that do not see a Gaussian, too,
    /// and the flow under a footprint is the sum weighted by alpha, not the mean.
    pub fn word_for_word() -> Self {
        let mut config = Self::literal();
        config.marking.all_views = true;
        config.association.normalise = false;
        config
    }

    /// The settings of the motion initialisation.
    pub fn motion(&self) -> MotionConfig {
        MotionConfig {
            marking: self.marking,
            voronoi: self.voronoi,
            agreement: self.agreement,
            association: self.association,
            triangulation: self.triangulation,
            fusion: self.fusion,
            alignment: self.alignment,
            densification: self.densification,
        }
    }

    /// The settings of a frame's steps but for the motion initialisation.
    pub fn reconstruction(&self) -> ReconstructionConfig {
        ReconstructionConfig {
            seed: self.seed,
            sky_face_size: self.sky_face_size,
            first_frame: self.first_frame,
            marking: self.marking,
            groups: self.fusion.groups,
            densification: self.densification,
            birth: self.birth,
            resolution: self.resolution,
            dynamic: self.dynamic,
            background: self.background,
            disocclusion: self.disocclusion,
        }
    }

    /// These settings with another motion initialisation.
    #[must_use]
    pub(crate) fn with_motion(self, motion: &MotionConfig) -> Self {
        Self {
            marking: motion.marking,
            voronoi: motion.voronoi,
            agreement: motion.agreement,
            association: motion.association,
            triangulation: motion.triangulation,
            fusion: motion.fusion,
            alignment: motion.alignment,
            densification: motion.densification,
            ..self
        }
    }

    /// As TOML.
    ///
    /// # Errors
    /// When a value has no form in TOML.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).context("the configuration cannot be written as TOML")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_survives_a_round_trip_and_unknown_keys_are_refused() {
        let text = Config::default().to_toml().unwrap();
        assert_eq!(toml::from_str::<Config>(&text).unwrap(), Config::default());
        assert!(toml::from_str::<Config>("iterashuns = 3").is_err());
    }

    #[test]
    fn the_motion_initialisation_is_part_of_the_configuration() {
        let literal = MotionConfig::literal();
        assert_eq!(Config::default().with_motion(&literal).motion(), literal);
        let ours = Config::literal().with_motion(&MotionConfig::default());
        let Config { first_frame, birth, resolution, dynamic, background, disocclusion, .. } = ours;
        assert_eq!((birth.iterations, disocclusion.iterations, dynamic.loss_dilation), (0, 0, 0));
        assert_eq!([dynamic.prior_weight, resolution.splat_px, resolution.static_splat_px], [0.0; 3]);
        assert!(!first_frame.exposures);
        assert_eq!((background.static_method, background.static_iterations), (StaticMethod::Steps, 500));
        assert_eq!(
            ours,
            Config { first_frame, birth, resolution, dynamic, background, disocclusion, ..Config::default() }
        );
    }

    #[test]
    fn a_file_with_a_setting_out_of_range_names_file_key_value_and_range() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("settings.toml");
        std::fs::write(&file, "seed = 3\n[association]\nmin_transmittance = 0.5\ncontributors = 64").unwrap();
        assert_eq!(Config::read(&file).unwrap().association.contributors, 64);
        std::fs::write(&file, "voronoi.k = 0\nfirst_frame.sh_degree = 4").unwrap();
        let error = format!("{:#}", Config::read(&file).unwrap_err());
        for part in ["settings.toml", "voronoi.k = 0: must be at least 1", "first_frame.sh_degree = 4"] {
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn whatever_is_wrong_with_a_file_it_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("settings.toml");
        let refused = || format!("{:#}", Config::read(&file).unwrap_err());
        assert!(refused().contains("settings.toml"), "missing: {}", refused());
        let faults: [&[u8]; 6] = [
            b"seed = ",
            b"sead = 1",
            b"seed = 'one'",
            b"[voronoi]\nk = inf",
            b"seed = -1",
            b"seed = 1 # \xff",
        ];
        for fault in faults {
            std::fs::write(&file, fault).unwrap();
            assert!(refused().contains("settings.toml"), "{}: {}", fault.escape_ascii(), refused());
        }
        std::fs::write(&file, vec![b'#'; 1 + MAX_BYTES as usize]).unwrap();
        assert!(refused().contains("settings.toml"), "too long: {}", refused());
    }

    /// Seventeen digits through run.json: a resume compares them with what the file says.
    #[test]
    fn every_number_survives_json_exactly() {
        let mut config = Config::default();
        config.marking.loss_warning = 0.472_749_088_465_466_8;
        config.fusion.correlation_inflation = 1.433_973_882_466_274_7;
        config.first_frame.position_rate = f32::from_bits(0x3951_b718);
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(serde_json::from_str::<Config>(&text).unwrap(), config);
        let value = serde_json::to_value(config).unwrap();
        assert_eq!(serde_json::from_value::<Config>(value).unwrap(), config);
    }
}

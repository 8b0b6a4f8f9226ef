//! Fuses the trackers' estimates with the temporal prior, validates and plans densification.

//! Tracker outputs (npz, flo, EXR, npy) to the motion types of core, and their validation.

//! Which SIMD instruction set the machine has; numerical loops choose it at run time.

use pulp::Arch;
use std::sync::LazyLock;
use thiserror::Error;

/// Names another instruction set than the widest that the processor has.
const VARIABLE: &str = "FFGS_SIMD";

/// The names that it may have.
const NAMES: [&str; 3] = ["scalar", "avx2", "avx512"];

static CHOSEN: LazyLock<Result<Arch, NoSuchInstructions>> =
    LazyLock::new(|| std::env::var(VARIABLE).map_or_else(|_| Ok(Arch::new()), |name| named(&name)));

/// `FFGS_SIMD` names no instruction set, or one that this processor does not have.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "{VARIABLE} = {0:?}: choose scalar, avx2 or avx512, as far as this processor has them, or leave it out"
)]
pub struct NoSuchInstructions(String);

/// The vector instructions of every stage: the widest that the processor has, or those that the environment variable
/// `FFGS_SIMD` names, so that machines of two kinds can be told to give the same bytes. One choice for the whole process.
pub fn instructions() -> Arch {
    CHOSEN.as_ref().map_or_else(|_| Arch::new(), |chosen| *chosen)
}

/// The name of these instructions, for the description of a run; that of the processor's architecture where they have none.
pub fn instruction_set() -> &'static str {
    let kind = |arch: &Arch| std::mem::discriminant(arch);
    let is_chosen = |name: &&str| named(name).is_ok_and(|arch| kind(&arch) == kind(&instructions()));
    NAMES.into_iter().find(is_chosen).unwrap_or(std::env::consts::ARCH)
}

/// Refuses a name that cannot be had; for the start of a program.
///
/// # Errors
/// When `FFGS_SIMD` names no instruction set of this processor.
pub fn check_instructions() -> Result<(), NoSuchInstructions> {
    CHOSEN.clone().map(|_| ())
}

fn named(name: &str) -> Result<Arch, NoSuchInstructions> {
    let found = match name {
        "scalar" => Some(Arch::Scalar),
        #[cfg(target_arch = "x86_64")]
        "avx2" => pulp::x86::V3::try_new().map(Arch::V3),
        #[cfg(target_arch = "x86_64")]
        "avx512" => pulp::x86::V4::try_new().map(Arch::V4),
        _ => None,
    };
    found.ok_or_else(|| NoSuchInstructions(name.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chosen_set_has_the_name_that_chooses_it() {
        let kind = |arch: Arch| std::mem::discriminant(&arch);
        match named(instruction_set()) {
            Ok(arch) => assert_eq!(kind(arch), kind(instructions())),
            Err(_) => assert_eq!(instruction_set(), std::env::consts::ARCH),
        }
    }

    #[test]
    fn a_name_is_a_set_or_is_refused() {
        assert!(matches!(named("scalar"), Ok(Arch::Scalar)));
        for name in ["", "AVX2", "sse9"] {
            assert!(named(name).unwrap_err().to_string().contains("choose scalar, avx2 or avx512"));
        }
    }
}

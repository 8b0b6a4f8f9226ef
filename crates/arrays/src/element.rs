//! The types that entries of a numpy array are converted to; a value that the type cannot hold is refused, not rounded away.

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
    impl Sealed for i64 {}
    impl Sealed for i32 {}
    impl Sealed for u8 {}
}

/// A type that a numpy array can be read as.
pub trait Element: sealed::Sealed + Copy {
    /// The numpy name.
    const NAME: &'static str;
    /// From a floating-point entry; `None` when it cannot be held.
    fn from_f64(value: f64) -> Option<Self>;
    /// From a signed entry.
    fn from_i64(value: i64) -> Option<Self>;
    /// From an unsigned entry.
    fn from_u64(value: u64) -> Option<Self>;
}

macro_rules! float_element {
    ($type:ty, $name:literal) => {
        impl Element for $type {
            const NAME: &'static str = $name;
            fn from_f64(value: f64) -> Option<Self> {
                Some(value as Self)
            }
            fn from_i64(value: i64) -> Option<Self> {
                Some(value as Self)
            }
            fn from_u64(value: u64) -> Option<Self> {
                Some(value as Self)
            }
        }
    };
}

macro_rules! integer_element {
    ($type:ty, $name:literal) => {
        impl Element for $type {
            const NAME: &'static str = $name;
            fn from_f64(value: f64) -> Option<Self> {
                let whole = value.trunc() == value && value.abs() < 9.0e18;
                whole.then_some(value as i64).and_then(Self::from_i64)
            }
            fn from_i64(value: i64) -> Option<Self> {
                Self::try_from(value).ok()
            }
            fn from_u64(value: u64) -> Option<Self> {
                Self::try_from(value).ok()
            }
        }
    };
}

float_element!(f32, "float32");
float_element!(f64, "float64");
integer_element!(i64, "int64");
integer_element!(i32, "int32");
integer_element!(u8, "uint8");

//! The entropy coder of the stream, for other files of many small integers: an adaptive binary range coder and models of numbers.
//!
//! ```
//! use ffgs_stream::entropy::{Number, RangeDecoder, RangeEncoder};
//! let (mut encoder, mut model) = (RangeEncoder::new(), Number::default());
//! [3, 0, -1].map(|value| model.code(&mut encoder, value));
//! let bytes = encoder.finish();
//! let (mut decoder, mut model) = (RangeDecoder::new(&bytes), Number::default());
//! assert_eq!([0; 3].map(|_| model.code(&mut decoder, 0)), [3, 0, -1]);
//! ```

pub use crate::numbers::{Flag, Number};
pub use crate::range_coder::{Bit, Coder, Decoder as RangeDecoder, Encoder as RangeEncoder};

//! Vectors, the language, and host against device.

mod codec;
mod pair;

//! Vectors, the language, what is sent and what is not.

mod codec;

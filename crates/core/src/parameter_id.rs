//! The number of a parameter.

/// Position of a parameter in [`Profile::parameters`](crate::profile::Profile::parameters).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct ParameterId(pub u16);

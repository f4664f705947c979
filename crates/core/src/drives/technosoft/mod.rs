//! Technosoft and Techsoft drives, which speak TML.
//!
//! Sources: the "TML communication" chapters, the vendor's library TML_LIB_light and its help pages;
//! for memory maps, captures of drives with firmware F514L and FA00G. What is concluded and not
//! stated is marked \[I\], and `inferred` in the profiles.

pub mod profile;

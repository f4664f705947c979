//! Replaces the tables of `decode` in a program that was built without them.

use super::Decode;
use crate::problem::{Result, left_out_problem};

impl Decode {
    pub(super) fn decode_columns(&self) -> Result {
        Err(left_out_problem("tables", "Parquet and Arrow"))
    }

    pub(super) fn decode_folder(&self) -> Result {
        Err(left_out_problem("tables", "data sets"))
    }
}

//! Checks of numbers that users give.

use crate::PanelError;

/// Checks that a number is finite and within bounds.
pub(crate) fn within(field: &str, value: f64, low: f64, high: f64) -> Result<(), PanelError> {
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err(PanelError::OutOfRange { field: field.to_owned(), value, low, high })
    }
}

/// Checks results before they leave: all numbers of a part have to be finite.
pub(crate) fn results(what: &'static str, numbers: impl IntoIterator<Item = f64>) -> Result<(), PanelError> {
    if numbers.into_iter().all(f64::is_finite) { Ok(()) } else { Err(PanelError::Overflow { what }) }
}

/// Checks that a number is finite. The field's name is made only for the error.
pub(crate) fn finite(value: f64, field: impl Fn() -> String) -> Result<(), PanelError> {
    if value.is_finite() { Ok(()) } else { within(&field(), value, f64::MIN, f64::MAX) }
}

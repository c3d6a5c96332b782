//! The unit of length of a STEP file.

use super::entity::Entity;
use crate::{
    error::ImportError,
    model::FileUnit,
    part21::{Exchange, Value},
};

/// Units defined by other units at most.
const CHAIN: usize = 4;

/// The first unit of length of a context.
pub(super) fn length_unit(exchange: &Exchange<'_>) -> Result<Option<FileUnit>, ImportError> {
    for number in exchange.of_type(&["GLOBAL_UNIT_ASSIGNED_CONTEXT"]) {
        let context = Entity::parse(exchange, number)?;
        let Ok(record) = context.record("GLOBAL_UNIT_ASSIGNED_CONTEXT") else { continue };
        for unit in context.list(record, record.parameters.len().saturating_sub(1))? {
            let &Value::Reference(unit) = unit else { continue };
            let unit = Entity::parse(exchange, unit)?;
            if unit.is("LENGTH_UNIT") {
                return reading(unit).map(Some);
            }
        }
    }
    Ok(None)
}

fn reading(mut unit: Entity<'_, '_>) -> Result<FileUnit, ImportError> {
    let mut metres = 1.0;
    let mut label = None;
    for _ in 0..CHAIN {
        if let Ok(record) = unit.record("SI_UNIT") {
            // OpenVSP writes .UNSET. for no prefix.
            let prefix = match unit.value(record, 0)? {
                Value::Enumeration(prefix) => *prefix,
                _ => "",
            };
            let factor = match prefix {
                "" | "UNSET" => 1.0,
                "KILO" => 1e3,
                "DECI" => 1e-1,
                "CENTI" => 1e-2,
                "MILLI" => 1e-3,
                "MICRO" => 1e-6,
                other => return Err(unit.error(format!("the prefix .{other}. is not known for lengths"))),
            };
            let prefix = if prefix == "UNSET" { "" } else { prefix };
            let label = label.unwrap_or_else(|| format!("{}metre", prefix.to_ascii_lowercase()));
            return Ok(FileUnit { label, metres: metres * factor });
        }
        let record = unit.record("CONVERSION_BASED_UNIT")?;
        label.get_or_insert(unit.text(record, 0)?.to_ascii_lowercase());
        let measure = unit.follow(record, 1)?;
        let record = ["LENGTH_MEASURE_WITH_UNIT", "MEASURE_WITH_UNIT"];
        let record = record.into_iter().find_map(|k| measure.record(k).ok());
        let Some(record) = record else { return Err(measure.error("is no measure of a length".into())) };
        let factor = measure.number(record, 0)?;
        if !(1e-9..=1e9).contains(&factor) {
            return Err(measure.error(format!("a unit of {factor} is not between 1e-9 and 1e9")));
        }
        metres *= factor;
        unit = measure.follow(record, 1)?;
    }
    Err(unit.error(format!("units are defined by each other, more than {CHAIN} deep")))
}

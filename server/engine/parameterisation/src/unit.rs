//! Units in which a user declares design variables.

use std::fmt;

/// The dimension of a variable; two units are interchangeable when their dimensions agree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dimension {
    /// Dimensionless: factors, fractions of the local chord.
    Ratio,
    /// Length, in metres inside.
    Length,
    /// Area, in square metres inside.
    Area,
    /// Angle, in radians inside.
    Angle,
}

/// The unit of a declared variable. Values, bounds and baselines are all in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// `1`
    One,
    /// `percent`, 0.01
    Percent,
    /// `m`
    Metre,
    /// `ft`, 0.3048 m
    Foot,
    /// `m^2`
    SquareMetre,
    /// `ft^2`, 0.3048^2 m^2
    SquareFoot,
    /// `deg`
    Degree,
    /// `rad`
    Radian,
}

impl Unit {
    /// All units, in the order of the documentation.
    pub const ALL: [Unit; 8] = [
        Unit::One,
        Unit::Percent,
        Unit::Metre,
        Unit::Foot,
        Unit::SquareMetre,
        Unit::SquareFoot,
        Unit::Degree,
        Unit::Radian,
    ];

    /// Multiplies a value in this unit to give metres, square metres, radians or a plain ratio.
    pub fn to_si(self) -> f64 {
        const FOOT: f64 = 0.3048;
        match self {
            Unit::One | Unit::Metre | Unit::SquareMetre | Unit::Radian => 1.0,
            Unit::Percent => 0.01,
            Unit::Foot => FOOT,
            Unit::SquareFoot => FOOT * FOOT,
            Unit::Degree => std::f64::consts::PI / 180.0,
        }
    }

    /// The dimension of the unit.
    pub fn dimension(self) -> Dimension {
        match self {
            Unit::One | Unit::Percent => Dimension::Ratio,
            Unit::Metre | Unit::Foot => Dimension::Length,
            Unit::SquareMetre | Unit::SquareFoot => Dimension::Area,
            Unit::Degree | Unit::Radian => Dimension::Angle,
        }
    }

    /// The name users write: `1`, `percent`, `m`, `ft`, `m^2`, `ft^2`, `deg`, `rad`.
    pub fn symbol(self) -> &'static str {
        match self {
            Unit::One => "1",
            Unit::Percent => "percent",
            Unit::Metre => "m",
            Unit::Foot => "ft",
            Unit::SquareMetre => "m^2",
            Unit::SquareFoot => "ft^2",
            Unit::Degree => "deg",
            Unit::Radian => "rad",
        }
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.symbol())
    }
}

impl fmt::Display for Dimension {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Dimension::Ratio => "a ratio (1, percent)",
            Dimension::Length => "a length (m, ft)",
            Dimension::Area => "an area (m^2, ft^2)",
            Dimension::Angle => "an angle (deg, rad)",
        })
    }
}

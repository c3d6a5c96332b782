//! parameterisation

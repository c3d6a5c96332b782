//! Symmetry, solver and doubt: every choice once, with its word on the command line and its value in the protocol.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use moldline_panel::{OnDoubt, Solver, Symmetry};
use moldline_proto::v1::{PanelOnDoubt, PanelSolver, PanelSymmetry};

/// A choice of the panel method (`T`) and its value in the protocol (`M`).
#[derive(Debug)]
pub struct Choice<T, M> {
    word: &'static str,
    help: &'static str,
    value: T,
    message: M,
}

/// Symmetry about the plane y = 0.
pub static SYMMETRIES: [Choice<Symmetry, PanelSymmetry>; 4] = [
    Choice::new("automatic", "As the mesh is", Symmetry::Automatic, PanelSymmetry::Unspecified),
    Choice::new("none", "Every cell is solved", Symmetry::None, PanelSymmetry::None),
    Choice::new("half", "The mesh is one half", Symmetry::Half, PanelSymmetry::Half),
    Choice::new("mirror", "The mesh has both halves, one is solved", Symmetry::Mirror, PanelSymmetry::Mirror),
];

/// Solvers of the linear system.
pub static SOLVERS: [Choice<Solver, PanelSolver>; 4] = [
    Choice::new("automatic", "By the number of unknowns", Solver::Automatic, PanelSolver::Unspecified),
    Choice::new("double", "LU in double precision", Solver::Double, PanelSolver::Double),
    Choice::new("single", "LU in single precision, refined", Solver::Single, PanelSolver::Single),
    Choice::new("iterative", "GMRES", Solver::Iterative, PanelSolver::Iterative),
];

/// What becomes of an answer that a check finds wrong.
pub static ON_DOUBT: [Choice<OnDoubt, PanelOnDoubt>; 2] = [
    Choice::new("refuse", "It is refused", OnDoubt::Refuse, PanelOnDoubt::Refuse),
    Choice::new("warn", "It is given with a warning", OnDoubt::Warn, PanelOnDoubt::Warn),
];

impl<T, M> Choice<T, M> {
    const fn new(word: &'static str, help: &'static str, value: T, message: M) -> Self {
        Self { word, help, value, message }
    }
}

/// The value of a number in messages; `None` if the number has no name.
pub fn of_message<T: Copy, M: Copy + Into<i32>>(choices: &[Choice<T, M>], message: i32) -> Option<T> {
    choices.iter().find(|choice| choice.message.into() == message).map(|choice| choice.value)
}

/// The number of a choice in messages.
pub fn to_message<T: Copy + PartialEq, M: Copy + Into<i32>>(choices: &[Choice<T, M>], value: T) -> i32 {
    choices.iter().find(|choice| choice.value == value).map_or(0, |choice| choice.message.into())
}

/// Parses the words of the command line.
pub fn words<T, M>(choices: &'static [Choice<T, M>]) -> impl TypedValueParser<Value = T>
where
    T: Copy + Send + Sync + 'static,
    M: Sync,
{
    let words = choices.iter().map(|choice| PossibleValue::new(choice.word).help(choice.help));
    PossibleValuesParser::new(words).try_map(move |word| {
        choices.iter().find(|choice| choice.word == word).map(|choice| choice.value).ok_or("no such choice")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_are_those_of_the_protocol() {
        for number in 0..4 {
            assert_eq!(to_message(&SYMMETRIES, of_message(&SYMMETRIES, number).unwrap()), number);
            assert_eq!(to_message(&SOLVERS, of_message(&SOLVERS, number).unwrap()), number);
        }
        assert!(of_message(&SYMMETRIES, 4).is_none() && of_message(&SOLVERS, -1).is_none());
    }
}

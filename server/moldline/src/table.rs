//! Tables for the terminal.

use std::time::Duration;

/// Aligns columns, with two spaces between them.
pub fn render<const N: usize>(rows: &[[String; N]]) -> String {
    /// Longer cells stand out; formats have a limit of their own for widths.
    const WIDEST: usize = 1000;
    let longest = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let width = |column| longest(column).min(WIDEST);
    let widths: [usize; N] = std::array::from_fn(width);
    let mut text = String::new();
    for row in rows {
        let cells = row.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}"));
        text += cells.collect::<Vec<_>>().join("  ").trim_end();
        text.push('\n');
    }
    text
}

/// A duration in its two largest units.
pub fn duration(duration: Duration) -> String {
    let seconds = duration.as_secs();
    match seconds {
        0 => format!("{} ms", duration.as_millis()),
        1..60 => format!("{:.1} s", duration.as_secs_f64()),
        60..3600 => format!("{} min {} s", seconds / 60, seconds % 60),
        3600..86_400 => format!("{} h {} min", seconds / 3600, seconds / 60 % 60),
        _ => format!("{} d {} h", seconds / 86_400, seconds / 3600 % 24),
    }
}

/// A bar of `width` characters, filled by `share`.
pub fn bar(share: f64, width: usize) -> String {
    let full = (share.clamp(0.0, 1.0) * width as f64).round() as usize;
    "█".repeat(full) + &"░".repeat(width - full)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_are_short() {
        let of = |seconds| duration(Duration::from_secs_f64(seconds));
        assert_eq!(
            [of(0.0666), of(12.34), of(75.0), of(7260.0), of(180_000.0)],
            ["66 ms", "12.3 s", "1 min 15 s", "2 h 1 min", "2 d 2 h"]
        );
        assert_eq!([bar(0.0, 4), bar(0.5, 4), bar(7.0, 4), bar(f64::NAN, 2)], ["░░░░", "██░░", "████", "░░"]);
    }

    #[test]
    fn columns_line_up() {
        let rows = [["a", "long name"], ["bb", "x"]].map(|row| row.map(str::to_owned));
        assert_eq!(render(&rows), "a   long name\nbb  x\n");
        // Beyond what a format takes as a width.
        let rows = ["x".to_owned(), "y".repeat(70_000)].map(|cell| [cell, "z".to_owned()]);
        assert_eq!(render(&rows).lines().map(str::len).max(), Some(70_003));
    }
}

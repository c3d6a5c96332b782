//! Tables for the terminal.

use std::time::Duration;

/// Columns as wide as they need to be, two spaces between them.
pub fn render<const N: usize>(rows: &[[String; N]]) -> String {
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: [usize; N] = std::array::from_fn(width);
    let mut text = String::new();
    for row in rows {
        let cells = row.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}"));
        text += cells.collect::<Vec<_>>().join("  ").trim_end();
        text.push('\n');
    }
    text
}

/// In the two units that say most.
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

/// In the largest unit of which there is one.
pub fn bytes(bytes: u64) -> String {
    const UNITS: [&str; 5] = ["B", "KiB", "MiB", "GiB", "TiB"];
    let mut value = bytes as f64;
    let mut unit = 0;
    while value >= 1024.0 && unit + 1 < UNITS.len() {
        value /= 1024.0;
        unit += 1;
    }
    if unit == 0 || value >= 100.0 {
        format!("{value:.0} {}", UNITS[unit])
    } else {
        format!("{value:.1} {}", UNITS[unit])
    }
}

/// A bar of `width` cells, `share` of it full.
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
        assert_eq!(
            [bytes(0), bytes(1023), bytes(1536), bytes(200 << 20), bytes(5 << 40)],
            ["0 B", "1023 B", "1.5 KiB", "200 MiB", "5.0 TiB"]
        );
        assert_eq!([bar(0.0, 4), bar(0.5, 4), bar(7.0, 4), bar(f64::NAN, 2)], ["░░░░", "██░░", "████", "░░"]);
    }

    #[test]
    fn columns_line_up() {
        let rows = [["a", "long name"], ["bb", "x"]].map(|row| row.map(str::to_owned));
        assert_eq!(render(&rows), "a   long name\nbb  x\n");
    }
}

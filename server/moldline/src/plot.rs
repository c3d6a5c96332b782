//! Figures as PNG. The font is compiled in, so that figures are the same on every machine.

use moldline_check::DesignCheck;
use moldline_parameterisation::Group;
use plotters::{prelude::*, style::register_font};

/// A figure that cannot be drawn.
#[derive(Debug, thiserror::Error)]
pub enum PlotError {
    /// The compiled-in font cannot be read.
    #[error("the compiled-in font cannot be read")]
    Font,
    /// Drawing fails.
    #[error("{0}")]
    Drawing(String),
    /// Encoding fails.
    #[error("{0}")]
    Encoding(#[from] png::EncodingError),
}

const WIDTH: u32 = 1200;
const HEIGHT: u32 = 800;
/// Smaller errors are drawn at this value.
const LEAST: f64 = 1e-16;

/// Plots relative errors against the step of the differences: a curve for each variable, a colour for each group of variables. The bytes of a PNG file.
pub fn plateau(title: &str, groups: &[Group], check: &DesignCheck) -> Result<Vec<u8>, PlotError> {
    register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular()).map_err(|_| PlotError::Font)?;
    let mut pixels = vec![0; (3 * WIDTH * HEIGHT) as usize];
    draw(title, groups, check, &mut pixels).map_err(|error| PlotError::Drawing(error.to_string()))?;
    encoded(&pixels, WIDTH, HEIGHT)
}

/// The bytes of a PNG file with these pixels: red, green and blue, row by row from above.
pub fn encoded(pixels: &[u8], width: u32, height: u32) -> Result<Vec<u8>, PlotError> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header()?.write_image_data(pixels)?;
    Ok(file)
}

fn draw(
    title: &str,
    groups: &[Group],
    check: &DesignCheck,
    pixels: &mut [u8],
) -> Result<(), Box<dyn std::error::Error>> {
    let steps = || check.variables.iter().flat_map(|v| v.differences.iter().map(|d| d.step));
    let (low, high) = steps().fold((1.0_f64, 0.0_f64), |(low, high), s| (low.min(s), high.max(s)));
    let area = BitMapBackend::with_buffer(pixels, (WIDTH, HEIGHT)).into_drawing_area();
    area.fill(&WHITE)?;
    let (figure, key) = area.split_horizontally(WIDTH - 230);
    let mut chart = ChartBuilder::on(&figure)
        .caption(title, ("sans-serif", 22))
        .margin(15)
        .x_label_area_size(50)
        .y_label_area_size(80)
        .build_cartesian_2d((0.5 * low..2.0 * high).log_scale(), (LEAST..10.0).log_scale())?;
    let power = |x: &f64| format!("1e{:.0}", x.log10());
    chart
        .configure_mesh()
        .x_desc("step of the central difference / range of the variable")
        .y_desc("|difference - J v| / |J v| over all vertices")
        .x_labels(12)
        .y_labels(18)
        .x_label_formatter(&power)
        .y_label_formatter(&power)
        .label_style(("sans-serif", 16))
        .axis_desc_style(("sans-serif", 18))
        .light_line_style(RGBColor(240, 240, 240))
        .bold_line_style(RGBColor(215, 215, 215))
        .draw()?;
    let colour = |g: usize| {
        let hue = g as f64 / groups.len().max(1) as f64;
        HSLColor(hue, 0.75, if g.is_multiple_of(2) { 0.42 } else { 0.55 })
    };
    for variable in &check.variables {
        let group = groups.iter().position(|g| g.range.contains(&variable.variable)).unwrap_or(0);
        let points: Vec<(f64, f64)> = variable
            .differences
            .iter()
            .filter_map(|d| d.error.map(|error| (d.step, error.clamp(LEAST, 10.0))))
            .collect();
        let style = colour(group).stroke_width(1);
        chart.draw_series(LineSeries::new(points.iter().copied(), style))?;
        chart.draw_series(points.iter().map(|&at| Circle::new(at, 2, colour(group).filled())))?;
    }
    let shown =
        (0..groups.len()).filter(|&g| check.variables.iter().any(|v| groups[g].range.contains(&v.variable)));
    for (row, g) in shown.enumerate() {
        let y = 60 + 24 * row as i32;
        let line = PathElement::new([(0, y), (24, y)], colour(g).stroke_width(3));
        key.draw(&line)?;
        let name = shortened(&groups[g].name);
        key.draw(&Text::new(name, (32, y - 8), ("sans-serif", 16)))?;
    }
    drop(chart);
    area.present()?;
    Ok(())
}

/// A name that fits beside the figure.
fn shortened(name: &str) -> String {
    const FITS: usize = 22;
    if name.chars().count() <= FITS {
        return name.to_owned();
    }
    let end: String = name.chars().skip(name.chars().count() - FITS + 1).collect();
    format!("\u{2026}{end}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use moldline_check::{Difference, VariableCheck};

    fn check(error: f64) -> DesignCheck {
        let differences = (2..=9)
            .map(|k| Difference { step: 10_f64.powi(-k), error: Some(error * 10_f64.powi(-2 * k)) })
            .collect();
        let variable = VariableCheck {
            variable: 0,
            size: 1.0,
            dual: 0.0,
            worst_vertex: 0,
            steps: Vec::new(),
            first_off: None,
            differences,
            kink: None,
            functions: 0.0,
        };
        DesignCheck { design: vec![0.0], values: 0.0, dot_products: Vec::new(), variables: vec![variable] }
    }

    #[test]
    fn a_figure_shows_text_and_the_curve() {
        let groups = [Group { name: "wing.translation".to_owned(), shape: Vec::new(), range: 0..1 }];
        let decode = |file: &[u8]| {
            let mut reader = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
            let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut pixels).unwrap();
            pixels
        };
        let figure = decode(&plateau("a title", &groups, &check(1.0)).unwrap());
        assert_eq!(figure.len(), (3 * WIDTH * HEIGHT) as usize);
        let untitled = decode(&plateau("", &groups, &check(1.0)).unwrap());
        let other = decode(&plateau("a title", &groups, &check(100.0)).unwrap());
        let differ = |a: &[u8], b: &[u8]| a.iter().zip(b).filter(|(a, b)| a != b).count();
        assert!(differ(&figure, &untitled) > 100, "letters");
        assert!(differ(&figure, &other) > 1000, "a curve");
    }

    #[test]
    fn long_names_keep_their_end() {
        assert_eq!(shortened("wing.twist"), "wing.twist");
        assert_eq!(shortened("a.very.long.name.of.a.variable"), "\u{2026}ng.name.of.a.variable");
    }
}

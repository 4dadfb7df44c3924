//! Tables and the numbers in them, for people.

/// A Markdown table that is also readable as it is.
pub(crate) fn aligned(rows: &[Vec<String>]) -> String {
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..rows[0].len()).map(width).collect();
    // Words to the left, numbers to the right.
    let line = |row: &[String]| {
        let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| {
            if column < 2 { format!(" {cell:<width$} ") } else { format!(" {cell:>width$} ") }
        });
        format!("|{}|\n", cells.collect::<Vec<_>>().join("|"))
    };
    let ruler = widths
        .iter()
        .enumerate()
        .map(|(column, &width)| if column < 2 { "-".repeat(width + 2) } else { format!("{}:", "-".repeat(width + 1)) });
    let ruler = format!("|{}|\n", ruler.collect::<Vec<_>>().join("|"));
    let [head, rows @ ..] = rows else { return String::new() };
    line(head) + &ruler + &rows.iter().map(|row| line(row)).collect::<String>()
}

pub(crate) fn time(ns: f64) -> String {
    let (value, unit) = unit(ns);
    format!("{} {unit}", digits(value))
}

/// Nanoseconds in the unit that fits.
pub(crate) fn unit(ns: f64) -> (f64, &'static str) {
    match ns {
        _ if ns < 999.5 => (ns, "ns"),
        _ if ns < 999.5e3 => (ns / 1e3, "µs"),
        _ if ns < 999.5e6 => (ns / 1e6, "ms"),
        _ => (ns / 1e9, "s"),
    }
}

/// Three digits that count, at most three decimals.
pub(crate) fn digits(value: f64) -> String {
    let decimals = if value < 1.0 {
        3
    } else if value < 10.0 {
        2
    } else {
        usize::from(value < 100.0)
    };
    format!("{value:.decimals$}")
}

/// 1234567 as 1,234,567.
pub(crate) fn grouped(n: usize) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

//! What a benchmark has written, `docs/NAME.csv` and the head of `docs/NAME.md`.

use std::path::Path;

#[derive(Debug)]
pub(crate) struct Recorded {
    head: Vec<String>,
    rows: Vec<Vec<String>>,
    /// Which machine, commit and day, in a line.
    pub(crate) origin: String,
}

/// A line of the CSV.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row<'a>(&'a Recorded, &'a [String]);

impl Recorded {
    pub(crate) fn read(docs: &Path, name: &str) -> Self {
        let text = |ending: &str| {
            let path = docs.join(name).with_extension(ending);
            std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
        };
        let (csv, page) = (text("csv"), text("md"));
        let mut rows = csv.lines().map(cells);
        let head = rows.next().expect("a CSV has a head");
        let field = |what: &str| {
            let start = format!("* {what}: ");
            page.lines().find_map(|line| line.strip_prefix(&start)).unwrap_or("unknown")
        };
        let origin = format!(
            "{}, {} cores, {}; commit {}; {}",
            field("processor"),
            field("cores"),
            field("instruction set"),
            field("commit"),
            field("date")
        );
        Self { head, rows: rows.collect(), origin }
    }

    /// The lines whose cells are these, of the columns with these names.
    pub(crate) fn rows<'a>(&'a self, wanted: &[(&str, &str)]) -> Vec<Row<'a>> {
        let all = self.rows.iter().map(|cells| Row(self, cells));
        all.filter(|row| wanted.iter().all(|(column, value)| row.text(column) == *value)).collect()
    }

    /// The only line of which that holds.
    pub(crate) fn one(&self, wanted: &[(&str, &str)]) -> Row<'_> {
        let rows = self.rows(wanted);
        assert_eq!(rows.len(), 1, "{wanted:?}");
        rows[0]
    }
}

impl<'a> Row<'a> {
    pub(crate) fn text(self, column: &str) -> &'a str {
        let at = self.0.head.iter().position(|name| name == column);
        &self.1[at.unwrap_or_else(|| panic!("no column {column}"))]
    }

    pub(crate) fn number(self, column: &str) -> f64 {
        let text = self.text(column);
        text.parse().unwrap_or_else(|_| panic!("{column} is {text:?}, and no number"))
    }
}

/// Cells with commas stand between quotes.
fn cells(line: &str) -> Vec<String> {
    let (mut cells, mut is_quoted) = (vec![String::new()], false);
    for character in line.chars() {
        match character {
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => cells.push(String::new()),
            _ => cells.last_mut().expect("there is one").push(character),
        }
    }
    cells
}

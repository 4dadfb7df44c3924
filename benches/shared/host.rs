//! What machine it is, and what was measured on it.

use fearless_simd::Level;

/// What a reader needs to know to compare: no names, no paths.
pub(crate) fn description() -> Vec<(&'static str, String)> {
    let processor = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let field = |name: &str| {
        let line = processor.lines().find(|line| line.starts_with(name))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    };
    let cores = std::thread::available_parallelism().map_or_else(|_| "unknown".to_owned(), |n| n.to_string());
    let changed = !output("git", &["status", "--porcelain", "--", ":!docs"]).unwrap_or_default().is_empty();
    let commit = output("git", &["rev-parse", "--short", "HEAD"]).unwrap_or_else(|| "unknown".to_owned());
    vec![
        ("processor", field("model name").unwrap_or_else(|| std::env::consts::ARCH.to_owned())),
        ("cores", cores),
        (
            "instruction set",
            format!("{:?}", Level::new()).chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect(),
        ),
        ("compiler", output("rustc", &["--version"]).unwrap_or_else(|| "unknown".to_owned())),
        ("commit", if changed { commit + " and changes" } else { commit }),
        ("date", today()),
    ]
}

fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let output = std::process::Command::new(program)
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .ok()
        .filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}

/// The date in UTC, as year-month-day: days since 1970 counted off year by year and month by month.
fn today() -> String {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    let mut days = now.as_secs() / 86_400;
    let mut year = 1970;
    let leap = |year: u64| u64::from(year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400)));
    while days >= 365 + leap(year) {
        days -= 365 + leap(year);
        year += 1;
    }
    let mut month = 0;
    let lengths = [31, 28 + leap(year), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    while days >= lengths[month] {
        days -= lengths[month];
        month += 1;
    }
    format!("{year}-{:02}-{:02}", month + 1, days + 1)
}

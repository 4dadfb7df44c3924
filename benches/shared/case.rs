//! What a benchmark of the service is made of, and how it is run.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

use crate::report::{self, Bench};

/// A question, and how it is answered.
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) title: &'static str,
    /// What is done and how it is measured, for the reader of the table.
    pub(crate) note: &'static str,
    pub(crate) run: fn(&mut Bench),
}

/// What this program is when it is started once more with such a first argument; it is given the others.
pub(crate) type Child = (&'static str, fn(&[String]));

/// Runs those cases that the arguments name, all without a name.
pub(crate) fn run(cases: &[Case], children: &[Child]) -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let has = |wanted: &str| arguments.iter().any(|argument| argument == wanted);
    if let [first, others @ ..] = &arguments[..]
        && let Some((_, child)) = children.iter().find(|(name, _)| name == first)
    {
        child(others);
        return ExitCode::SUCCESS;
    }
    let measuring = has("--bench") && !has("--test");
    if !measuring && has("--list") {
        return ExitCode::SUCCESS; // For test runners: it is one check without a name.
    }
    let filter: Vec<&String> = arguments.iter().filter(|argument| !argument.starts_with("--")).collect();
    let mut bench = Bench::new(measuring);
    for case in cases {
        if !filter.is_empty() && !filter.iter().any(|filter| case.name.contains(filter.as_str())) {
            continue;
        }
        bench.case = case.name;
        if catch_unwind(AssertUnwindSafe(|| (case.run)(&mut bench))).is_err() {
            bench.check(false, || "it panicked, see above".to_owned());
        }
        if measuring {
            println!("\n{}\n\n{}", case.title, report::table(case, &bench.figures));
        }
    }
    for failure in &bench.failures {
        eprintln!("failed: {failure}");
    }
    if !bench.failures.is_empty() {
        return ExitCode::FAILURE;
    }
    // Only a whole run is worth recording.
    if arguments == ["--bench"] {
        report::write(cases, &bench).expect("docs/ can be written");
    }
    ExitCode::SUCCESS
}

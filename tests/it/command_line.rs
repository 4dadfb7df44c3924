//! The binary as its user meets it: flags, variables, start-up lines, signals, exit codes.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::SocketAddr;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};

use serde_json::json;

use crate::service::{Client, wait_for_in_flight};

pub(crate) fn pointmass() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pointmass"));
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn output(arguments: &[&str]) -> Output {
    pointmass().args(arguments).output().expect("the binary starts")
}

/// A running service of the binary; killed when it is dropped.
pub(crate) struct Running {
    child: Child,
    lines: BufReader<std::process::ChildStdout>,
    log: Box<dyn BufRead>,
}

impl Running {
    pub(crate) fn start(mut command: Command) -> Self {
        let mut child = command.spawn().expect("the binary starts");
        let lines = BufReader::new(child.stdout.take().expect("piped"));
        let log: Box<dyn BufRead> = match child.stderr.take() {
            Some(log) => Box::new(BufReader::new(log)),
            None => Box::new(std::io::empty()),
        };
        Self { child, lines, log }
    }

    /// The next start-up line.
    pub(crate) fn listening_on(&mut self) -> String {
        let mut line = String::new();
        self.lines.read_line(&mut line).expect("a line");
        let url = line.strip_prefix("pointmass listening on ").unwrap_or_else(|| panic!("{line:?}"));
        url.trim_end().to_owned()
    }

    pub(crate) fn address(&mut self) -> SocketAddr {
        let url = self.listening_on();
        url.strip_prefix("http://").expect("a TCP listener").parse().expect("an address")
    }

    pub(crate) fn signal(&self, name: &str) {
        let kill = format!("kill -{name} {}", self.child.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().expect("a shell").success());
    }

    /// Waits for the next line of the log with these words.
    #[track_caller]
    pub(crate) fn logged(&mut self, words: &str) -> String {
        let mut line = String::new();
        while !line.contains(words) {
            line.clear();
            assert!(self.log.read_line(&mut line).expect("a line") > 0, "it ended without {words:?}");
        }
        line
    }

    /// From now on nobody reads its log.
    pub(crate) fn close_log(&mut self) {
        self.log = Box::new(std::io::empty());
    }

    /// The exit code, what else it wrote to standard output, and the rest of its log.
    pub(crate) fn end(mut self) -> (Option<i32>, String, String) {
        let status = self.child.wait().expect("it ends");
        let (mut out, mut log) = (String::new(), String::new());
        self.lines.read_to_string(&mut out).expect("text");
        self.log.read_to_string(&mut log).expect("text");
        (status.code(), out, log)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ended = self.child.kill();
        let _reaped = self.child.wait();
    }
}

/// Waits until the service has taken note of a signal.
#[track_caller]
fn wait_until_draining(address: SocketAddr) {
    let mut client = Client::connect(address);
    assert!((0..100_000).any(|_| client.get("/readyz").status == 503), "the signal never arrived");
}

pub(crate) fn temporary(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("pointmass-{}-{name}", std::process::id()))
}

#[test]
fn it_listens_where_it_is_told_and_says_so_in_order() {
    let socket = temporary("a.sock");
    let unix = format!("unix:{}", socket.display());
    for words in [&["serve"][..], &[]] {
        let mut command = pointmass();
        command.args(words).args(["--listen", "127.0.0.1:0", "--listen", &unix, "--listen", "localhost:0"]);
        let mut running = Running::start(command);
        let first = running.address();
        assert_eq!(running.listening_on(), unix);
        let third = running.address();
        Client::connect(first).put("/v1/worlds/a", "").expect(201);
        assert_eq!(Client::connect(third).get("/v1/worlds/a").expect(200).json()["revision"], 0);
        let mut stream = UnixStream::connect(&socket).expect("it listens");
        stream.write_all(b"GET /v1/worlds/a HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n").expect("open");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer");
        assert!(answer.starts_with("HTTP/1.1 200 OK") && answer.contains("\"revision\":0"), "{answer}");
        running.signal("TERM");
        let (code, out, log) = running.end();
        assert_eq!((code, out.as_str()), (Some(0), ""), "{log}");
        assert!(!socket.exists(), "the socket is removed");
    }
}

#[test]
fn a_socket_left_behind_is_taken_over_and_one_in_use_is_not() {
    let socket = temporary("b.sock");
    let unix = format!("unix:{}", socket.display());
    drop(std::os::unix::net::UnixListener::bind(&socket).expect("a socket"));
    let mut command = pointmass();
    command.args(["--listen", &unix]);
    let mut running = Running::start(command);
    assert_eq!(running.listening_on(), unix);
    let second = output(&["--listen", &unix]);
    assert_eq!(second.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&second.stderr).contains("a service answers there already"));
    let plain = temporary("c.file");
    std::fs::write(&plain, "precious").expect("a file");
    assert_eq!(output(&["--listen", &format!("unix:{}", plain.display())]).status.code(), Some(1));
    assert_eq!(std::fs::read_to_string(&plain).expect("still there"), "precious");
    std::fs::remove_file(&plain).expect("ours");
    running.signal("INT");
    assert_eq!(running.end().0, Some(0));
}

#[test]
fn signals_finish_what_is_in_flight() {
    for signal in ["TERM", "INT"] {
        let mut command = pointmass();
        command.args(["--listen", "127.0.0.1:0", "--log-format", "json"]);
        let mut running = Running::start(command);
        let address = running.address();
        let mut client = Client::connect(address);
        client.put("/v1/worlds/a", "{\"integrator\":\"newton_euler\"}").expect(201);
        client.post("/v1/worlds/a/particles", "{\"count\":4000,\"velocity\":[1,0,0]}").expect(201);
        let mut idle = Client::connect(address);
        idle.get("/healthz").expect(200);
        let body = "{\"duration\":1,\"steps\":1000000}";
        client.raw(
            format!(
                "POST /v1/worlds/a/advance HTTP/1.1\r\nhost: localhost\r\ncontent-length: {}\r\n\r\n{body}",
                body.len()
            )
            .as_bytes(),
        );
        wait_for_in_flight(address, 1);
        running.signal(signal);
        // While it finishes, it says so to whoever comes.
        wait_until_draining(address);
        let mut late = Client::connect(address);
        assert_eq!(late.get("/readyz").expect(503).json()["code"], "shutting_down");
        let refused = late.put("/v1/worlds/late", "").expect(503);
        assert_eq!(refused.header("retry-after"), Some("1"));
        late.get("/healthz").expect(200);
        let answer = client.answer(false).expect(200);
        assert_eq!(answer.json()["step_count"], 1_000_000);
        assert!(idle.try_answer(false).is_none(), "idle connections are closed");
        let (code, _, log) = running.end();
        assert_eq!(code, Some(0), "{log}");
        for line in log.lines() {
            let line: serde_json::Value = serde_json::from_str(line).expect("a log line is JSON");
            assert_eq!(line["level"], "INFO", "{line}");
        }
    }
}

/// Half a request line is no request: it does not hold up the end for the time that a header may take.
#[test]
fn half_a_request_line_does_not_hold_up_the_end() {
    let mut command = pointmass();
    command.args(["--listen", "127.0.0.1:0", "--header-timeout-ms", "600000", "--drain-timeout-ms", "600000"]);
    let mut running = Running::start(command);
    let address = running.address();
    let mut half = Client::connect(address);
    half.get("/healthz").expect(200);
    let mut fresh = Client::connect(address);
    fresh.raw(b"GET /hea");
    half.raw(b"GET /hea");
    Client::connect(address).get("/healthz").expect(200);
    running.signal("TERM");
    assert_eq!(running.end().0, Some(0));
}

#[test]
fn a_second_signal_ends_it_at_once() {
    let mut command = pointmass();
    command.args(["--listen", "127.0.0.1:0"]);
    let mut running = Running::start(command);
    let address = running.address();
    let mut half = Client::connect(address);
    half.raw(b"POST /v1/worlds HTTP/1.1\r\nhost: localhost\r\ncontent-length: 5\r\n\r\n{");
    wait_for_in_flight(address, 1);
    running.signal("TERM");
    // Two signals that come together are one to a process.
    wait_until_draining(address);
    running.signal("TERM");
    assert_ne!(running.end().0, Some(0));
}

#[test]
fn beyond_loopback_it_wants_a_token_or_a_clear_word() {
    let refused = output(&["--listen", "0.0.0.0:0"]);
    assert_eq!(refused.status.code(), Some(1));
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    for way in ["--token-file", "POINTMASS_TOKEN", "--insecure-no-auth"] {
        assert!(message.contains(way), "{message}");
    }
    let tokens = temporary("tokens");
    std::fs::write(&tokens, "# none\n").expect("a file");
    let path = tokens.display().to_string();
    let empty = output(&["--listen", "0.0.0.0:0", "--token-file", &path]);
    assert!(String::from_utf8_lossy(&empty.stderr).contains("has no token"));
    std::fs::write(&tokens, "0123456789abcdef0123456789abcdef\n").expect("a file");
    for (arguments, variable, status) in [
        (&["--token-file", path.as_str()][..], None, 401),
        (&[], Some("POINTMASS_TOKEN"), 401),
        (&[], Some("POINTMASS_READ_ONLY_TOKEN"), 401),
        (&["--insecure-no-auth"], None, 200),
    ] {
        let mut command = pointmass();
        command.args(["--listen", "0.0.0.0:0"]).args(arguments);
        command.envs(variable.map(|variable| (variable, "0123456789abcdef0123456789abcdef")));
        let mut running = Running::start(command);
        let port = running.address().port();
        Client::connect(([127, 0, 0, 1], port).into()).get("/v1").expect(status);
    }
    std::fs::remove_file(&tokens).expect("ours");
}

#[test]
fn a_flag_wins_over_its_variable() {
    let mut command = pointmass();
    command.env("POINTMASS_LISTEN", "127.0.0.1:0").env("POINTMASS_STEPS_MAX", "5").env("POINTMASS_WORLDS_MAX", "6");
    command.args(["--worlds-max", "7"]);
    let mut running = Running::start(command);
    let limits = Client::connect(running.address()).get("/v1").json()["limits"].clone();
    assert_eq!((&limits["steps_max"], &limits["worlds_max"]), (&json!(5), &json!(7)));
}

#[test]
fn every_option_has_a_variable_and_stands_in_the_help() {
    let help = output(&["serve", "--help"]);
    let help = String::from_utf8_lossy(&help.stdout).into_owned();
    let mut options = 0;
    for line in help.lines().filter(|line| line.trim_start().starts_with("--")) {
        let flag = line.trim_start().trim_start_matches("--").split([' ', '=']).next().expect("a name");
        let variable = match flag {
            "log" => "POINTMASS_LOG".to_owned(),
            flag => format!("POINTMASS_{}", flag.to_uppercase().replace('-', "_")),
        };
        assert!(help.contains(&format!("[env: {variable}=")), "--{flag} has no {variable}:\n{help}");
        options += 1;
    }
    assert!(options >= 18, "{options} options in\n{help}");
    assert!(help.contains("POINTMASS_TOKEN and POINTMASS_READ_ONLY_TOKEN"), "{help}");
    assert!(output(&["--help"]).stdout.starts_with(b"Worlds of point-mass particles over HTTP"));
    assert_eq!(output(&["--version"]).stdout, format!("pointmass {}\n", env!("CARGO_PKG_VERSION")).into_bytes());
}

#[test]
fn wrong_words_are_explained() {
    let other = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let in_use = other.local_addr().expect("bound").to_string();
    for (arguments, code, words) in [
        (
            &["--listen", "127.0.0.1:99999"][..],
            1,
            "cannot listen on 127.0.0.1:99999: a port is a number from 0 to 65535",
        ),
        (&["--listen", "in valid:8080"], 1, "a host is an IP address of this machine or a name that has one"),
        (&["--listen", "203.0.113.7:0", "--insecure-no-auth"], 1, "no interface of this machine has this address"),
        (&["--listen", &in_use], 1, "stop what listens there, or choose another port: 0 takes any that is free"),
        (&["--listen", "unix:/nowhere/at/all.sock"], 1, "its folder must exist"),
        (&["--allow-host", "http://physics.example"], 2, "is not a name like physics.example"),
        (&["--allow-host", "physics.example:8080"], 2, "without scheme and port"),
        (&["--token-file", "/nowhere/tokens"], 1, "cannot read the token file /nowhere/tokens"),
        (&["--threads", "0"], 2, "must be at least 1"),
        (&["--steps-max", "many"], 2, "--steps-max"),
        (&["--listn", "x"], 2, "--listen"),
        // An argument can be seen by every user of the machine.
        (&["--token", "x"], 2, "unexpected argument"),
        (&["--read-only-token", "x"], 2, "unexpected argument"),
        (&["start"], 2, "start"),
        (&["--log", "a=b=c"], 1, "--log"),
        (&["healthcheck", "--url", "ftp://localhost"], 1, "not an http:// URL"),
    ] {
        let output = output(arguments);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
        assert!(message.contains(words), "{arguments:?}: {message}");
    }
}

/// What is nearly an address is answered with the address.
#[test]
fn what_is_no_address_is_answered_with_what_to_write() {
    for (address, right) in [
        ("8080", "write --listen 127.0.0.1:8080 for clients on this machine, --listen 0.0.0.0:8080 for all"),
        (":8080", "write --listen 127.0.0.1:8080 for clients on this machine, --listen 0.0.0.0:8080 for all"),
        ("*:9000", "write --listen 127.0.0.1:9000 for clients on this machine, --listen 0.0.0.0:9000 for all"),
        ("", "write --listen 127.0.0.1:8080 for clients on this machine, --listen 0.0.0.0:8080 for all"),
        ("localhost", "like 127.0.0.1:8080; write --listen localhost:8080"),
        ("127.0.0.1", "like 127.0.0.1:8080; write --listen 127.0.0.1:8080"),
        ("nonsense", "like 127.0.0.1:8080; write --listen nonsense:8080"),
        ("[::1]", "like 127.0.0.1:8080; write --listen [::1]:8080"),
        ("::1", "write --listen [::1]:8080"),
        ("localhost:", "write --listen localhost:8080, for example"),
        ("localhost:http", "write --listen localhost:8080, for example"),
        ("http://127.0.0.1:8080", "write --listen 127.0.0.1:8080"),
        ("http://localhost", "write --listen localhost:8080"),
        ("https://localhost:8080/", "write --listen localhost:8080"),
        ("/run/pointmass.sock", "write --listen unix:/run/pointmass.sock"),
    ] {
        let output = output(&["--listen", address]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{address}: {message}");
        assert!(message.starts_with(&format!("pointmass: cannot listen on {address}: ")), "{address}: {message}");
        assert!(message.trim_end().ends_with(right), "{address}: {message}");
    }
}

/// The help has its options in groups; the short one has what a newcomer needs, and says where the rest is.
#[test]
fn the_help_is_in_groups() {
    let help = |arguments: &[&str]| String::from_utf8_lossy(&output(arguments).stdout).into_owned();
    let headings = |help: &str| -> Vec<String> {
        let lines = help.lines().filter_map(|line| line.strip_suffix(':')).filter(|line| !line.starts_with(' '));
        lines.map(str::to_owned).filter(|line| line != "Commands").collect()
    };
    for command in [&[][..], &["serve"]] {
        let (long, short) = (help(&[command, &["--help"]].concat()), help(&[command, &["-h"]].concat()));
        let groups = [
            "Options",
            "Listening",
            "Access",
            "Logging",
            "Threads",
            "Limits of worlds",
            "Limits of the work of a request",
            "Limits of sizes",
            "Queues",
            "Requests that are sent again",
            "Connections",
            "Timeouts",
        ];
        assert_eq!(headings(&long), groups, "{long}");
        assert_eq!(headings(&short), groups[..4], "{short}");
        assert!(short.contains("--listen") && short.contains("--token-file") && !short.contains("-max"), "{short}");
        assert!(short.contains("Print help (see more with '--help')"), "{short}");
        // No option stands outside of them.
        let ungrouped = long.split("\nListening:").next().and_then(|long| long.split("\nOptions:").nth(1));
        let own = ungrouped.expect("both").lines().filter(|line| line.trim_start().starts_with('-'));
        assert!(own.map(str::trim).all(|line| line.starts_with("-h") || line.starts_with("-V")), "{long}");
    }
}

#[test]
fn healthcheck_tells_by_its_exit_code() {
    let mut command = pointmass();
    let socket = temporary("d.sock");
    command.args(["--listen", "127.0.0.1:0", "--listen", &format!("unix:{}", socket.display())]);
    let mut running = Running::start(command);
    let url = running.listening_on();
    assert_eq!(output(&["healthcheck", "--url", &format!("{url}/healthz")]).status.code(), Some(0));
    assert_eq!(output(&["healthcheck", "--url", &url]).status.code(), Some(0), "as it is printed");
    assert_eq!(output(&["healthcheck", "--url", &running.listening_on()]).status.code(), Some(0));
    assert_eq!(output(&["healthcheck", "--url", &format!("{url}/nowhere")]).status.code(), Some(1));
    running.signal("TERM");
    running.end();
    let gone = output(&["healthcheck", "--url", &format!("{url}/healthz")]);
    assert_eq!(gone.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&gone.stderr).contains("does not answer"));
}

/// One line for each request, with what leads from it to the client and its trace, and nothing that is a secret.
#[test]
fn every_request_has_a_line_in_the_log() {
    for (arguments, logged) in
        [(&["--log", "info", "--log-format", "json"][..], true), (&["--log-format", "json"], false)]
    {
        let mut command = pointmass();
        command.args(["--listen", "127.0.0.1:0"]).args(arguments);
        let mut service = Running::start(command);
        let mut client = Client::connect(service.address());
        let trace = ("traceparent", "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01");
        let id = ("x-request-id", "mine");
        client
            .send("PUT", "/v1/worlds/a?secret=1", &[trace, id, ("authorization", "Bearer hush")], Some(b"{}"))
            .expect(422);
        client.send("GET", "/v1/worlds", &[("traceparent", "00-0-0-01")], None).expect(200);
        drop(client);
        service.signal("TERM");
        let (code, _, log) = service.end();
        assert_eq!(code, Some(0));
        assert!(!log.contains("hush") && !log.contains("secret"), "{log}");
        let lines: Vec<serde_json::Value> = log
            .lines()
            .filter(|line| line.contains("pointmass::access"))
            .map(|line| serde_json::from_str(line).expect("JSON"))
            .collect();
        assert_eq!(lines.len(), if logged { 2 } else { 0 }, "{log}");
        let [first, second] = &lines[..] else { continue };
        assert_eq!(first["level"], "INFO");
        let fields = &first["fields"];
        assert!(fields["duration_us"].is_u64());
        for (name, value) in [
            ("request_id", json!("mine")),
            ("trace_id", json!("0af7651916cd43dd8448eb211c80319c")),
            ("parent_id", json!("b7ad6b7169203331")),
            ("method", json!("PUT")),
            ("path", json!("/v1/worlds/a")),
            ("route", json!("/v1/worlds/{world}")),
            ("status", json!(422)),
        ] {
            assert_eq!(fields[name], value, "{name} in {first}");
        }
        assert!(second["fields"]["trace_id"].is_null(), "{second}");
    }
}

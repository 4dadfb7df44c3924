//! The way in for a person: `/` and the page at `/docs`.

use std::io::Read;

use flate2::read::GzDecoder;
use sha2::{Digest, Sha256};

use crate::service::{Service, shared};

const ABOUT: &str = include_str!("../../src/server/docs/README.md");
const POLICY: &str = "content-security-policy";

#[test]
fn the_front_leads_a_browser_to_the_page_and_tells_a_terminal_where_things_are() {
    let mut client = shared().client();
    let browser = "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8";
    let led = client.send("GET", "/", &[("accept", browser)], None).expect(303);
    assert_eq!((led.header("location"), led.header("vary")), (Some("/docs"), Some("accept")));
    for accept in [&[("accept", "*/*")][..], &[("accept", "text/html;q=0, */*")], &[]] {
        let told = client.send("GET", "/", accept, None).expect(200);
        assert_eq!(told.header("content-type"), Some("text/plain; charset=utf-8"));
        for address in ["\n/docs ", "\n/openapi.json ", "\n/v1 "] {
            assert!(told.text().contains(address), "{address} is not in {}", told.text());
        }
    }
    client.get("/?x=1").expect(422);
}

/// With and without a slash at the end, since links within it and reloads of them lead to the latter.
#[test]
fn the_page_asks_nobody_else() {
    let mut client = shared().client();
    let page = client.get("/docs").expect(200);
    assert_eq!(client.get("/docs/").expect(200).body, page.body);
    let policy = page.header(POLICY).expect("a policy");
    for source in policy.split("; ").flat_map(|rule| rule.split(' ').skip(1)) {
        assert!(matches!(source, "'none'" | "'self'" | "'unsafe-inline'" | "data:"), "{source} in {policy}");
    }
    assert!(policy.contains("script-src 'self';"), "{policy}");
    assert!(page.text().contains("name=\"viewport\" content=\"width=device-width"), "phones");
    let links: Vec<&str> = page.text().split(['"', '=']).filter(|text| text.starts_with('/')).collect();
    assert_eq!(links, ["/docs/swagger-ui.css", "/openapi.json", "/docs/swagger-ui-bundle.js", "/docs/start.js"]);
    for link in links {
        client.get(link).expect(200);
    }
    let start = client.get("/docs/start.js").expect(200);
    assert!(start.text().contains("url: \"/openapi.json\""), "the page is over the description");
    for text in [page.text(), start.text()] {
        assert!(!text.contains("http://") && !text.contains("https://"), "{text}");
    }
    client.get("/docs/nothing.js").expect(404);
}

/// What is built in is what its origin published.
#[test]
fn its_parts_are_sent_packed_once_and_whole() {
    let mut client = shared().client();
    let sums = ABOUT.lines().filter_map(|line| line.split_once("  ")).filter(|(sum, _)| sum.len() == 64);
    let mut parts = 0;
    for (sum, name) in sums {
        let path = format!("/docs/{name}");
        let plain = client.get(&path).expect(200);
        let hex = Sha256::digest(&plain.body).iter().fold(String::new(), |hex, byte| hex + &format!("{byte:02x}"));
        assert_eq!(hex, sum, "{name}");
        let packed = client.send("GET", &path, &[("accept-encoding", "gzip, deflate, br, zstd")], None).expect(200);
        assert_eq!((packed.header("content-encoding"), packed.header("vary")), (Some("gzip"), Some("accept-encoding")));
        assert!(packed.body.len() * 3 < plain.body.len(), "{name}: {}", packed.body.len());
        let mut unpacked = Vec::new();
        GzDecoder::new(&packed.body[..]).read_to_end(&mut unpacked).expect("whole");
        assert!(unpacked == plain.body, "{name} is another one when it is packed");
        let tags = [&plain, &packed].map(|answer| answer.header("etag").expect("a tag").to_owned());
        assert_ne!(tags[0], tags[1], "they are different bytes");
        for (tag, coding, status) in
            [(&tags[0], "identity", 304), (&tags[1], "gzip", 304), (&tags[0], "gzip", 200), (&tags[1], "identity", 200)]
        {
            let headers = [("if-none-match", tag.as_str()), ("accept-encoding", coding)];
            let answer = client.send("GET", &path, &headers, None).expect(status);
            assert_eq!(answer.body.is_empty(), status == 304);
        }
        parts += 1;
    }
    assert_eq!(parts, 2);
}

/// Whoever may know nothing of the worlds may still read how to ask.
#[test]
fn the_page_needs_no_token() {
    let file = std::env::temp_dir().join(format!("pointmass-docs-{}", std::process::id()));
    std::fs::write(&file, "a-token-that-is-long\n").expect("a file");
    let service = Service::with(|config| config.token_file = Some(file.clone()));
    let mut client = service.client();
    for path in ["/", "/docs", "/docs/", "/docs/start.js", "/openapi.json"] {
        client.get(path).expect(200);
    }
    client.get("/v1").expect(401);
    std::fs::remove_file(&file).expect("ours");
}

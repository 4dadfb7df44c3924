//! Who may come in: tokens, and pages of other origins.

use crate::service::Service;

#[test]
fn a_token_file_closes_everything_but_health_checks() {
    let path = std::env::temp_dir().join(format!("pointmass-tokens-{}", std::process::id()));
    std::fs::write(&path, "# two tokens\n\n0123456789abcdef0123456789abcdef\n  fedcba9876543210fedcba9876543210\n")
        .expect("a file");
    let service = Service::with(|config| config.token_file = Some(path.clone()));
    let mut client = service.client();
    for headers in [
        &[][..],
        &[("authorization", "Bearer wrong")],
        &[("authorization", "Bearer 0123456789abcdef0123456789abcde")],
        &[("authorization", "Bearer # two tokens")],
        &[("authorization", "Basic 0123456789abcdef0123456789abcdef")],
        &[("authorization", "0123456789abcdef0123456789abcdef")],
    ] {
        for (method, route) in
            [("GET", "/v1"), ("PUT", "/v1/worlds/a"), ("GET", "/metrics"), ("GET", "/openapi.json"), ("GET", "/docs")]
        {
            let answer = client.send(method, route, headers, (method == "PUT").then_some(b"{"));
            assert_eq!(answer.status, 401, "{method} {route} {headers:?}");
            assert_eq!(answer.header("www-authenticate"), Some("Bearer"));
        }
        client.send("GET", "/nowhere", headers, None).expect(401);
    }
    client.get("/healthz").expect(200);
    client.get("/readyz").expect(200);
    std::fs::remove_file(&path).expect("ours");
    for token in ["Bearer 0123456789abcdef0123456789abcdef", "bearer fedcba9876543210fedcba9876543210"] {
        client.send("GET", "/v1", &[("authorization", token)], None).expect(200);
    }
}

#[test]
fn pages_of_the_own_and_of_allowed_origins_may_ask() {
    let service = Service::with(|config| {
        config.allow_origin = vec!["https://game.example".to_owned()];
        config.allow_host = vec!["physics.example".to_owned()];
    });
    let mut client = service.client();
    for headers in [
        &[("host", "localhost:8080"), ("origin", "http://localhost:8080")][..],
        &[("host", "localhost:8080"), ("sec-fetch-site", "same-origin")],
        &[("host", "localhost:8080"), ("origin", "https://game.example"), ("sec-fetch-site", "cross-site")],
        &[("host", "physics.example")],
    ] {
        client.send("GET", "/v1", headers, None).expect(200);
    }
    client.send("GET", "/v1", &[("origin", "https://game.example.evil")], None).expect(403);
    let asked = [
        ("origin", "https://game.example"),
        ("access-control-request-method", "PUT"),
        ("access-control-request-headers", "if-match, authorization"),
    ];
    let preflight = client.send("OPTIONS", "/v1/worlds/a", &asked, None);
    assert_eq!(preflight.header("access-control-allow-headers"), Some("if-match, authorization"));
    assert_eq!(preflight.header("access-control-allow-origin"), Some("https://game.example"));
    let answer = client.send("GET", "/v1", &asked[..1], None).expect(200);
    assert_eq!(answer.header("access-control-allow-origin"), Some("https://game.example"));
    let other = client.send("OPTIONS", "/v1", &[("origin", "https://evil.example"), asked[1]], None);
    assert_eq!(other.header("access-control-allow-origin"), None);
}

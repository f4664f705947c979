use super::*;
use crate::scope::Scope;

const PEER: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(192, 0, 2, 1));

fn authenticator() -> (Authenticator, String) {
    let token = AccessToken::generate().unwrap();
    let text = token.reveal();
    let scopes: Scopes = "read,stop,move".parse().unwrap();
    let grant = Grant { token, scopes, name: "ann".into() };
    (Authenticator::new(vec![grant], "read,move,raw".parse().unwrap(), 80, false), text)
}

#[test]
fn a_token_and_its_cookie_grant_what_both_token_and_server_do() {
    let (door, text) = authenticator();
    let bearer = format!("Bearer {text}");
    let caller = door.authenticate(Some(&bearer), &[], PEER).unwrap();
    assert_eq!((&*caller.name, caller.by_cookie), ("ann", false));
    assert!(caller.scopes.contains(Scope::Move) && !caller.scopes.contains(Scope::Stop));
    let (_, cookie) = door.login(&text, PEER).unwrap();
    assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"));
    let pair = cookie.split(';').next().unwrap();
    let other = format!("other=1; {pair}");
    let inside = door.authenticate(None, &[&other], PEER).unwrap();
    assert!(inside.by_cookie && inside.scopes == caller.scopes);
    assert!(door.authenticate(None, &[&pair[..pair.len() - 1]], PEER).is_err());
    assert!(!cookie.contains(&text), "the cookie is not the token");
}

#[test]
fn a_token_that_is_good_once_is_good_once() {
    let (door, text) = authenticator();
    let once = door.issue_one_time_token().unwrap().reveal();
    assert!(door.login_one_time(&text, PEER).is_err(), "the other token is not that");
    assert!(door.login_one_time(&once, PEER).is_ok());
    assert_eq!(door.login_one_time(&once, PEER).unwrap_err().code, "gateway.token");
}

#[test]
fn wrong_tokens_are_counted_by_address_and_right_ones_still_stop() {
    let (door, text) = authenticator();
    for _ in 0..TRIES_MAX {
        assert_eq!(door.login(&"0".repeat(64), PEER).unwrap_err().code, "gateway.token");
    }
    assert_eq!(door.login(&text, PEER).unwrap_err().code, "gateway.limit");
    let bearer = format!("Bearer {text}");
    assert!(door.authenticate(Some(&bearer), &[], PEER).is_ok());
    assert_eq!(door.authenticate(Some("Bearer x"), &[], PEER).unwrap_err().code, "gateway.limit");
    let other = IpAddr::V4(std::net::Ipv4Addr::new(192, 0, 2, 2));
    assert!(door.login(&text, other).is_ok());
}

/// A page behind a proxy with HTTP Basic, or with a stale token: its cookie counts, however often it asks.
#[test]
fn a_known_cookie_counts_beside_another_authorization() {
    let (door, text) = authenticator();
    let cookie = door.login(&text, PEER).unwrap().1;
    let pair = cookie.split(';').next().unwrap();
    let stale = format!("Bearer {}", "0".repeat(64));
    for other in ["Basic dXNlcjpwYXNz", "basic x", "Digest a=b", "", &stale] {
        for _ in 0..2 * TRIES_MAX {
            assert!(door.authenticate(Some(other), &[pair], PEER).unwrap().by_cookie, "{other}");
        }
    }
    // No token was tried, and none was wrong.
    let basic = door.authenticate(Some("Basic dXNlcjpwYXNz"), &[], PEER).unwrap_err();
    assert_eq!(basic.code, "gateway.token");
    assert!(door.authenticate(Some(&format!("bearer  {text}")), &[], PEER).is_ok());
}

#[test]
fn browsers_are_let_in_up_to_a_number() {
    let (door, text) = authenticator();
    let first = door.login(&text, PEER).unwrap().1;
    for _ in 0..COOKIES_MAX {
        door.login(&text, PEER).unwrap();
    }
    let pair = first.split(';').next().unwrap();
    assert!(door.authenticate(None, &[pair], PEER).is_err());
    assert_eq!(door.lock().cookies.len(), COOKIES_MAX);
}

/// A file of its own for each test.
struct SessionTestFile(std::path::PathBuf);

impl SessionTestFile {
    fn new(test: &str) -> Self {
        let name = format!("polepair-sessions-{}-{test}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let _ = std::fs::remove_file(&path);
        Self(path)
    }

    fn read(&self) -> String {
        std::fs::read_to_string(&self.0).unwrap()
    }
}

impl Drop for SessionTestFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

const ALL: &str = "read,stop,move";

/// A server that starts with this token.
fn start_server(file: &SessionTestFile, token: &AccessToken, scopes: &str) -> Authenticator {
    let grant = Grant { token: token.clone(), scopes: scopes.parse().unwrap(), name: "ann".into() };
    Authenticator::new(vec![grant], ALL.parse().unwrap(), 80, false).with_session_file(&file.0)
}

fn enter(authenticator: &Authenticator, token: &AccessToken) -> String {
    let (_, cookie) = authenticator.login(&token.reveal(), PEER).unwrap();
    cookie.split(';').next().unwrap().to_owned()
}

#[test]
fn a_browser_is_still_let_in_by_the_server_that_is_started_again() {
    let (file, token) = (SessionTestFile::new("again"), AccessToken::generate().unwrap());
    let authenticator = start_server(&file, &token, ALL);
    let cookie = enter(&authenticator, &token);
    let before = authenticator.authenticate(None, &[&cookie], PEER).unwrap();
    let again = start_server(&file, &token, ALL);
    assert_eq!(again.authenticate(None, &[&cookie], PEER).unwrap(), before);
    // The present rights of the token hold, not those at the login.
    let narrower = start_server(&file, &token, "read");
    let viewer = narrower.authenticate(None, &[&cookie], PEER).unwrap();
    assert!(viewer.by_cookie && !viewer.scopes.contains(Scope::Stop));
    // A session stays valid when another one begins.
    let other = enter(&narrower, &token);
    let again = start_server(&file, &token, ALL);
    assert!([&cookie, &other].iter().all(|each| again.authenticate(None, &[each], PEER).is_ok()));
    // A token that is taken away takes its browsers along.
    let stranger = start_server(&file, &AccessToken::generate().unwrap(), ALL);
    assert_eq!(stranger.authenticate(None, &[&cookie], PEER).unwrap_err().code, "gateway.token");
}

#[test]
fn the_contents_of_the_file_admit_no_client() {
    let (file, token) = (SessionTestFile::new("digests"), AccessToken::generate().unwrap());
    let cookie = enter(&start_server(&file, &token, ALL), &token);
    let (_, secret) = cookie.split_once('=').unwrap();
    let text = file.read();
    assert!(!text.contains(secret) && !text.contains(&token.reveal()), "{text}");
    for word in text.split_whitespace() {
        let again = start_server(&file, &token, ALL);
        let pair = format!("polepair_80={word}");
        assert!(again.authenticate(None, &[&pair], PEER).is_err(), "{word}");
        assert!(again.authenticate(Some(&format!("Bearer {word}")), &[], PEER).is_err(), "{word}");
    }
}

#[test]
fn an_expired_or_unknown_token_admits_no_client() {
    let (file, token) = (SessionTestFile::new("times"), AccessToken::generate().unwrap());
    let cookie = enter(&start_server(&file, &token, ALL), &token);
    let text = file.read();
    let until: u64 = text.split_whitespace().last().unwrap().parse().unwrap();
    let lasts = COOKIE_LASTS.as_millis() as u64;
    for (moved, is_in) in
        [(until - 60_000, true), (until - lasts - 60_000, false), (until + 60_000, false)]
    {
        let moved = text.replace(&until.to_string(), &moved.to_string());
        std::fs::write(&file.0, moved).unwrap();
        let again = start_server(&file, &token, ALL);
        assert_eq!(again.authenticate(None, &[&cookie], PEER).is_ok(), is_in, "{until}");
    }
    // A session that has expired is not written again.
    let again = start_server(&file, &token, ALL);
    enter(&again, &token);
    assert_eq!(file.read().lines().count(), 2, "{}", file.read());
}

#[cfg(unix)]
#[test]
fn a_readable_or_broken_token_file_admits_no_client_and_is_made_anew() {
    use std::os::unix::fs::PermissionsExt as _;

    let (file, token) = (SessionTestFile::new("broken"), AccessToken::generate().unwrap());
    let mode = || std::fs::metadata(&file.0).unwrap().permissions().mode() & 0o777;
    let cookie = enter(&start_server(&file, &token, ALL), &token);
    assert_eq!(mode(), 0o600);
    std::fs::set_permissions(&file.0, std::fs::Permissions::from_mode(0o620)).unwrap();
    let again = start_server(&file, &token, ALL);
    assert!(
        again.authenticate(None, &[&cookie], PEER).is_err(),
        "somebody else may have written it"
    );
    let cookie = enter(&again, &token);
    assert_eq!(mode(), 0o600);
    let text = file.read();
    for broken in [text.replace(' ', "  "), text.replacen('\n', "\nx", 1), format!("{text}1\n")] {
        std::fs::write(&file.0, &broken).unwrap();
        let again = start_server(&file, &token, ALL);
        assert!(again.authenticate(None, &[&cookie], PEER).is_err(), "{broken}");
    }
    std::fs::write(&file.0, &text).unwrap();
    assert!(start_server(&file, &token, ALL).authenticate(None, &[&cookie], PEER).is_ok());
}

#[test]
fn the_file_is_bounded_as_the_browsers_are() {
    let (file, token) = (SessionTestFile::new("bounded"), AccessToken::generate().unwrap());
    let authenticator = start_server(&file, &token, ALL);
    (0..COOKIES_MAX + 3).for_each(|_| drop(enter(&authenticator, &token)));
    assert_eq!(file.read().lines().count(), COOKIES_MAX + 1);
    let again = start_server(&file, &token, ALL);
    assert_eq!(again.lock().cookies.len(), COOKIES_MAX);
    // The one that came in first goes first, after a start too.
    let first = again.lock().order[0];
    enter(&again, &token);
    assert!(!again.lock().cookies.contains_key(&first));
}

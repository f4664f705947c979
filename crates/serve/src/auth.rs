//! Authentication: tokens of programs, and cookies of browsers.
//!
//! Why: GW-16.

mod session_file;

use std::collections::{HashMap, VecDeque};
use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_link::clock;

use crate::error::SetupError;
use crate::message::{GatewayError, Proof, parse_hex};
use crate::scope::Scopes;
use crate::token::{AccessToken, Grant};
use session_file::{SessionFile, SessionRecord};

/// Limit of logged-in browsers; beyond it the oldest has to log in again.
const COOKIES_MAX: usize = 256;
/// Duration of a browser's login.
const COOKIE_LASTS: Duration = Duration::from_secs(12 * 3600);
/// Wrong tokens of one address within `TRIES_WITHIN`.
pub const TRIES_MAX: usize = 5;
/// Time for which a wrong token counts against its address.
const TRIES_WITHIN: Duration = Duration::from_secs(60);
/// Addresses whose tries are remembered.
const PEERS_MAX: usize = 1024;

/// An authenticated client and its scopes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Caller {
    /// Name in the journal.
    pub name: String,
    /// Scopes of the client.
    pub scopes: Scopes,
    /// True for a login by a cookie, which a browser also sends for foreign pages.
    pub by_cookie: bool,
}

/// All secrets that authenticate clients.
#[derive(Debug)]
pub struct Authenticator {
    grants: Vec<Grant>,
    /// The cookie's name: browsers send cookies to all ports of a host.
    cookie_name: String,
    secure: bool,
    state: Mutex<AuthState>,
    session_file: Option<SessionFile>,
}

#[derive(Debug, Default)]
struct AuthState {
    /// Logged-in browsers by the digest of their cookie, so that the time of a lookup reveals nothing of the others.
    cookies: HashMap<[u8; 32], BrowserSession>,
    /// The one that came in first is first.
    order: VecDeque<[u8; 32]>,
    one_time_token: Option<AccessToken>,
    tries: VecDeque<(IpAddr, VecDeque<Instant>)>,
}

/// Login of a browser.
#[derive(Debug)]
struct BrowserSession {
    caller: Caller,
    /// Digest of the token that it came in by.
    token_digest: [u8; 32],
    until: Instant,
}

impl Authenticator {
    /// Accepts these tokens, each for no more than `scopes`.
    #[must_use]
    pub fn new(mut grants: Vec<Grant>, scopes: Scopes, port: u16, secure: bool) -> Self {
        for grant in &mut grants {
            grant.scopes = grant.scopes.intersection(scopes);
        }
        let cookie_name = format!("polepair_{port}");
        Self { grants, cookie_name, secure, state: Mutex::default(), session_file: None }
    }

    /// Keeps logins in that file, and restores those whose token still exists, with its present scopes, until their
    /// end.
    ///
    /// An invalid file restores no login, and is written anew with the next one: a server that can stop motors is worth
    /// more.
    #[must_use]
    pub fn with_session_file(mut self, path: &Path) -> Self {
        let session_file = SessionFile::new(path);
        let lines = session_file.read(COOKIES_MAX).unwrap_or_else(|error| {
            tracing::warn!(%error, "cannot read the session file; earlier sessions are not \
             restored");
            Vec::new()
        });
        let now = clock::now();
        let now_ms = wall_ms(now);
        for SessionRecord { cookie_digest, token_digest, until_ms } in lines {
            let left = Duration::from_millis(until_ms.saturating_sub(now_ms));
            let grant = self.grants.iter().find(|grant| grant.token.digest() == token_digest);
            // An end further off than any that is given was not written by this clock.
            let (Some(grant), false) = (grant, left.is_zero() || left > COOKIE_LASTS) else {
                continue;
            };
            let caller = Caller { by_cookie: true, ..caller_of(grant) };
            self.lock().insert_session(
                cookie_digest,
                BrowserSession { caller, token_digest, until: now + left },
            );
        }
        self.session_file = Some(session_file);
        self
    }

    /// A new token that logs a browser in once, with the rights of the first token. The previous one becomes invalid.
    ///
    /// # Errors
    /// When there is no randomness.
    pub fn issue_one_time_token(&self) -> Result<AccessToken, SetupError> {
        let token = AccessToken::generate()?;
        self.lock().one_time_token = Some(token.clone());
        Ok(token)
    }

    /// Authenticates a client by its headers: `Authorization: Bearer …`, otherwise the cookie. Another scheme is no
    /// token: a proxy may ask for HTTP Basic, which browsers then send to the server too.
    ///
    /// # Errors
    /// `gateway.token`; `gateway.limit` after too many wrong ones.
    pub fn authenticate(
        &self,
        authorization: Option<&str>,
        cookies: &[&str],
        peer: IpAddr,
    ) -> Result<Caller, GatewayError> {
        let bearer = authorization.and_then(bearer_token);
        let grant = bearer.and_then(AccessToken::parse).and_then(|token| self.find_grant(&token));
        // A right token is never kept waiting by wrong ones: a stop may hang on it.
        if let Some(grant) = grant {
            return Ok(caller_of(grant));
        }
        let pairs = cookies.iter().flat_map(|cookie| cookie.split(';')).map(str::trim);
        let ours = pairs.filter_map(|pair| pair.split_once('='));
        let mut ours = ours.filter(|(name, _)| *name == self.cookie_name);
        let token = ours.next().and_then(|(_, value)| AccessToken::parse(value));
        match token.and_then(|token| self.find_session(&token)) {
            Some(caller) => Ok(caller),
            None if bearer.is_some() => Err(self.record_failure(peer)),
            None => Err(GatewayError::new("gateway.token", "a token is required")
                .hint("open the URL that `polepair serve` printed, or send a token of its file")),
        }
    }

    /// Logs a browser in by a token. Returns the client and its cookie. Waits for the disk if logins are
    /// [kept](Self::with_session_file).
    ///
    /// # Errors
    /// As [`authenticate`](Self::authenticate).
    pub fn login(&self, text: &str, peer: IpAddr) -> Result<(Caller, String), GatewayError> {
        self.check_tries(peer)?;
        let given = AccessToken::parse(text).and_then(|token| self.find_grant(&token));
        let grant = given.ok_or_else(|| self.record_failure(peer))?;
        self.open_session(grant)
    }

    /// Lets a browser in by the token that is good once. Waits likewise.
    ///
    /// # Errors
    /// As [`authenticate`](Self::authenticate).
    pub fn login_one_time(
        &self,
        text: &str,
        peer: IpAddr,
    ) -> Result<(Caller, String), GatewayError> {
        self.check_tries(peer)?;
        let given = AccessToken::parse(text);
        let access_token = {
            let mut inside = self.lock();
            if inside
                .one_time_token
                .as_ref()
                .is_some_and(|once| given.as_ref().is_some_and(|given| given.matches(once)))
            {
                inside.one_time_token.take()
            } else {
                None
            }
        };
        let grant = access_token.and(self.grants.first()).ok_or_else(|| {
            self.record_failure(peer).hint("it is valid once: restart the server for another one")
        })?;
        self.open_session(grant)
    }

    /// Proof for a client at that address that this is the server of the file's first token.
    ///
    /// # Errors
    /// `gateway.request` for a text that is no challenge, `gateway.missing` where there is no token.
    pub fn proof(&self, challenge: &str, address: SocketAddr) -> Result<Proof, GatewayError> {
        let challenge = parse_hex(challenge).ok_or_else(|| {
            GatewayError::new("gateway.request", "a challenge has 64 digits (hex)")
        })?;
        let first = self.grants.first();
        let first =
            first.ok_or_else(|| GatewayError::new("gateway.missing", "the token is missing"))?;
        Ok(Proof { proof: first.token.proof(&challenge, address) })
    }

    fn find_grant(&self, token: &AccessToken) -> Option<&Grant> {
        // All are compared, so that the time does not reveal the matching one.
        self.grants
            .iter()
            .fold(None, |found, grant| if grant.token.matches(token) { Some(grant) } else { found })
    }

    fn find_session(&self, token: &AccessToken) -> Option<Caller> {
        let inside = self.lock();
        let BrowserSession { caller, until, .. } = inside.cookies.get(&token.digest())?;
        (clock::now() < *until).then(|| caller.clone())
    }

    fn open_session(&self, grant: &Grant) -> Result<(Caller, String), GatewayError> {
        let value = AccessToken::generate()
            .map_err(|error| GatewayError::new("gateway.busy", error.to_string()))?;
        let caller = Caller { by_cookie: true, ..caller_of(grant) };
        let (token, until) = (grant.token.digest(), clock::now() + COOKIE_LASTS);
        let cookie = BrowserSession { caller: caller.clone(), token_digest: token, until };
        self.lock().insert_session(value.digest(), cookie);
        self.save_sessions();
        let secure = if self.secure { "; Secure" } else { "" };
        let (name, value, lasts) = (&self.cookie_name, value.reveal(), COOKIE_LASTS.as_secs());
        let rest = format!("Path=/; Max-Age={lasts}; HttpOnly; SameSite=Strict{secure}");
        Ok((caller, format!("{name}={value}; {rest}")))
    }

    /// Writes the logins to the file. If that fails, browsers log in again after the server's end.
    fn save_sessions(&self) {
        let Some(session_file) = &self.session_file else { return };
        // The check for permission to stop has the same lock: no disk is waited for under it.
        if let Err(error) = session_file.write(|| self.lock().session_records(clock::now())) {
            tracing::warn!(%error, "cannot write the session file; sessions end with this server");
        }
    }

    /// Refuses an address that gave too many wrong tokens.
    fn check_tries(&self, peer: IpAddr) -> Result<(), GatewayError> {
        let now = clock::now();
        let inside = self.lock();
        let tries = inside.tries.iter().find(|(address, _)| *address == peer);
        let recent = tries.map_or(0, |(_, tries)| {
            tries.iter().filter(|at| now.since(**at) < TRIES_WITHIN).count()
        });
        if recent < TRIES_MAX { Ok(()) } else { Err(too_many_tries_error()) }
    }

    /// Counts a wrong token, and returns its error.
    fn record_failure(&self, peer: IpAddr) -> GatewayError {
        if let Err(refused) = self.check_tries(peer) {
            return refused;
        }
        let mut inside = self.lock();
        let at = inside.tries.iter().position(|(address, _)| *address == peer);
        let mut tries =
            at.and_then(|at| inside.tries.remove(at)).map_or_else(VecDeque::new, |t| t.1);
        if tries.len() == TRIES_MAX {
            tries.pop_front();
        }
        tries.push_back(clock::now());
        if inside.tries.len() == PEERS_MAX {
            inside.tries.pop_front();
        }
        inside.tries.push_back((peer, tries));
        GatewayError::new("gateway.token", "that token is not one of this server's")
    }

    fn lock(&self) -> MutexGuard<'_, AuthState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl AuthState {
    fn insert_session(&mut self, digest: [u8; 32], cookie: BrowserSession) {
        if self.order.len() == COOKIES_MAX
            && let Some(first) = self.order.pop_front()
        {
            self.cookies.remove(&first);
        }
        self.order.push_back(digest);
        self.cookies.insert(digest, cookie);
    }

    /// Logins that have not ended, as records of the file.
    fn session_records(&self, now: Instant) -> Vec<SessionRecord> {
        let known =
            self.order.iter().filter_map(|digest| Some((digest, self.cookies.get(digest)?)));
        known
            .filter(|(_, cookie)| now < cookie.until)
            .map(|(digest, &BrowserSession { token_digest, until, .. })| SessionRecord {
                cookie_digest: *digest,
                token_digest,
                until_ms: wall_ms(until),
            })
            .collect()
    }
}

fn wall_ms(at: Instant) -> u64 {
    clock::wall_ns(at) / 1_000_000
}

fn caller_of(grant: &Grant) -> Caller {
    Caller { name: grant.name.clone(), scopes: grant.scopes, by_cookie: false }
}

/// The token of an `Authorization` header. The scheme's case does not count (RFC 9110, 11.1).
fn bearer_token(authorization: &str) -> Option<&str> {
    let (scheme, token) = authorization.split_once(' ')?;
    scheme.eq_ignore_ascii_case("Bearer").then(|| token.trim())
}

fn too_many_tries_error() -> GatewayError {
    GatewayError::new("gateway.limit", "too many wrong tokens from this address")
        .hint("wait a minute; logged-in clients can still stop motors")
}

#[cfg(test)]
mod tests;

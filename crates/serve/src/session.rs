//! Who is calling: tokens as they are sent, and the cookies that stand for them in browsers.
//!
//! Why: GW-16.

mod kept;

use std::collections::{HashMap, VecDeque};
use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_link::clock;

use crate::message::{Proof, Refused, of_digits};
use crate::refusal::Refusal;
use crate::scope::Scopes;
use crate::token::{Grant, Token};
use kept::{Kept, Line};

/// Browsers that are let in at once; the one that came in first has to log in again.
const COOKIES_MAX: usize = 256;
/// How long a browser is let in.
const COOKIE_LASTS: Duration = Duration::from_secs(12 * 3600);
/// Wrong tokens of one address within `TRIES_WITHIN`.
pub const TRIES_MAX: usize = 5;
/// How long a wrong token is held against its address.
const TRIES_WITHIN: Duration = Duration::from_secs(60);
/// Addresses whose tries are remembered.
const PEERS_MAX: usize = 1024;

/// Who somebody is, and what they may do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Caller {
    /// As the journal names them.
    pub name: String,
    /// What they may do.
    pub scopes: Scopes,
    /// A browser vouched for them by a cookie, which it sends whoever asks it to.
    pub by_cookie: bool,
}

/// Every secret that lets somebody in.
#[derive(Debug)]
pub struct Door {
    grants: Vec<Grant>,
    /// The cookie's name: browsers send cookies to all ports of a host.
    cookie: String,
    secure: bool,
    inside: Mutex<Inside>,
    kept: Option<Kept>,
}

#[derive(Debug, Default)]
struct Inside {
    /// By digest, so that looking one up tells nothing of the others.
    cookies: HashMap<[u8; 32], Cookie>,
    /// The one that came in first is first.
    order: VecDeque<[u8; 32]>,
    once: Option<Token>,
    tries: VecDeque<(IpAddr, VecDeque<Instant>)>,
}

/// What a browser was given.
#[derive(Debug)]
struct Cookie {
    caller: Caller,
    /// Digest of the token that it came in by.
    token: [u8; 32],
    until: Instant,
}

impl Door {
    /// A door that opens to these tokens, each for no more than `scopes`.
    #[must_use]
    pub fn new(mut grants: Vec<Grant>, scopes: Scopes, port: u16, secure: bool) -> Self {
        for grant in &mut grants {
            grant.scopes = grant.scopes.within(scopes);
        }
        let cookie = format!("polepair_{port}");
        Self { grants, cookie, secure, inside: Mutex::default(), kept: None }
    }

    /// Keeps who is let in in that file, and lets in whom it names: those whose token is still one of
    /// ours, for what it grants now, until the end that they were told.
    ///
    /// A file that is not as it has to be lets nobody in, and is written anew with the next who comes:
    /// a server that can stop motors is worth more.
    #[must_use]
    pub fn keeping(mut self, path: &Path) -> Self {
        let kept = Kept::at(path);
        let lines = kept.read(COOKIES_MAX).unwrap_or_else(|error| {
            tracing::warn!(%error, "nobody is logged in from before");
            Vec::new()
        });
        let now = clock::now();
        let now_ms = wall_ms(now);
        for Line { cookie, token, until_ms } in lines {
            let left = Duration::from_millis(until_ms.saturating_sub(now_ms));
            let grant = self.grants.iter().find(|grant| grant.token.digest() == token);
            // An end further off than any that is given was not written by this clock.
            let (Some(grant), false) = (grant, left.is_zero() || left > COOKIE_LASTS) else {
                continue;
            };
            let caller = Caller { by_cookie: true, ..caller(grant) };
            self.lock().let_in(cookie, Cookie { caller, token, until: now + left });
        }
        self.kept = Some(kept);
        self
    }

    /// A new token that lets a browser in once, as whoever the first token is for. The one before it
    /// is good no more.
    ///
    /// # Errors
    /// When there is no randomness.
    pub fn once(&self) -> Result<Token, Refusal> {
        let token = Token::new()?;
        self.lock().once = Some(token.clone());
        Ok(token)
    }

    /// Who sends these headers: `Authorization: Bearer …`, else our cookie.
    ///
    /// # Errors
    /// `gateway.token`; `gateway.limit` after too many wrong ones.
    pub fn who(
        &self,
        bearer: Option<&str>,
        cookies: &[&str],
        peer: IpAddr,
    ) -> Result<Caller, Refused> {
        if let Some(text) = bearer {
            let given = text.strip_prefix("Bearer ").and_then(Token::parse);
            // A right token is never kept waiting by wrong ones: a stop may hang on it.
            return match given.and_then(|token| self.granted(&token)) {
                Some(grant) => Ok(caller(grant)),
                None => Err(self.wrong(peer)),
            };
        }
        let pairs = cookies.iter().flat_map(|cookie| cookie.split(';')).map(str::trim);
        let ours = pairs.filter_map(|pair| pair.split_once('='));
        let mut ours = ours.filter(|(name, _)| *name == self.cookie);
        let token = ours.next().and_then(|(_, value)| Token::parse(value));
        token.and_then(|token| self.known(&token)).ok_or_else(|| {
            Refused::new("gateway.token", "this needs a token")
                .hint("open the URL that `polepair serve` printed, or send a token of its file")
        })
    }

    /// Lets a browser in by a token. Returns who it is and the cookie that says so. Waits for the disk
    /// where it is [kept](Self::keeping).
    ///
    /// # Errors
    /// As [`who`](Self::who).
    pub fn login(&self, text: &str, peer: IpAddr) -> Result<(Caller, String), Refused> {
        self.may_try(peer)?;
        let given = Token::parse(text).and_then(|token| self.granted(&token));
        let grant = given.ok_or_else(|| self.wrong(peer))?;
        self.let_in(grant)
    }

    /// Lets a browser in by the token that is good once. Waits likewise.
    ///
    /// # Errors
    /// As [`who`](Self::who).
    pub fn login_once(&self, text: &str, peer: IpAddr) -> Result<(Caller, String), Refused> {
        self.may_try(peer)?;
        let given = Token::parse(text);
        let taken = {
            let mut inside = self.lock();
            let is = |once: &Token| given.as_ref().is_some_and(|given| given.is(once));
            if inside.once.as_ref().is_some_and(is) { inside.once.take() } else { None }
        };
        let grant = taken.and(self.grants.first()).ok_or_else(|| {
            self.wrong(peer).hint("it is good once: start the server again for another one")
        })?;
        self.let_in(grant)
    }

    /// What shows that this is the server of the file's first token, to who asks at that address.
    ///
    /// # Errors
    /// `gateway.request` for what is no challenge, `gateway.missing` where there is no token.
    pub fn proof(&self, challenge: &str, address: SocketAddr) -> Result<Proof, Refused> {
        let challenge = of_digits(challenge)
            .ok_or_else(|| Refused::new("gateway.request", "a challenge has 64 digits (hex)"))?;
        let first = self.grants.first();
        let first = first.ok_or_else(|| Refused::new("gateway.missing", "there is no token"))?;
        Ok(Proof { proof: first.token.proof(&challenge, address) })
    }

    fn granted(&self, token: &Token) -> Option<&Grant> {
        // All are compared, so that the time taken does not tell which.
        self.grants
            .iter()
            .fold(None, |found, grant| if grant.token.is(token) { Some(grant) } else { found })
    }

    fn known(&self, token: &Token) -> Option<Caller> {
        let inside = self.lock();
        let Cookie { caller, until, .. } = inside.cookies.get(&token.digest())?;
        (clock::now() < *until).then(|| caller.clone())
    }

    fn let_in(&self, grant: &Grant) -> Result<(Caller, String), Refused> {
        let value =
            Token::new().map_err(|error| Refused::new("gateway.busy", error.to_string()))?;
        let caller = Caller { by_cookie: true, ..caller(grant) };
        let (token, until) = (grant.token.digest(), clock::now() + COOKIE_LASTS);
        let cookie = Cookie { caller: caller.clone(), token, until };
        self.lock().let_in(value.digest(), cookie);
        self.keep();
        let secure = if self.secure { "; Secure" } else { "" };
        let (name, value, lasts) = (&self.cookie, value.reveal(), COOKIE_LASTS.as_secs());
        let rest = format!("Path=/; Max-Age={lasts}; HttpOnly; SameSite=Strict{secure}");
        Ok((caller, format!("{name}={value}; {rest}")))
    }

    /// Writes down who is let in. Where that cannot be, they log in again once the server has ended.
    fn keep(&self) {
        let Some(kept) = &self.kept else { return };
        // Who asks whether somebody may stop has the same lock: no disk is waited for under it.
        if let Err(error) = kept.write(|| self.lock().lines(clock::now())) {
            tracing::warn!(%error, "who is logged in is forgotten when the server ends");
        }
    }

    /// Refuses an address that gave too many wrong tokens.
    fn may_try(&self, peer: IpAddr) -> Result<(), Refused> {
        let now = clock::now();
        let inside = self.lock();
        let tries = inside.tries.iter().find(|(address, _)| *address == peer);
        let recent = tries.map_or(0, |(_, tries)| {
            tries.iter().filter(|at| now.since(**at) < TRIES_WITHIN).count()
        });
        if recent < TRIES_MAX { Ok(()) } else { Err(too_many()) }
    }

    /// Remembers a wrong token, and says so.
    fn wrong(&self, peer: IpAddr) -> Refused {
        if let Err(refused) = self.may_try(peer) {
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
        Refused::new("gateway.token", "that token is not one of this server's")
    }

    fn lock(&self) -> MutexGuard<'_, Inside> {
        self.inside.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inside {
    fn let_in(&mut self, digest: [u8; 32], cookie: Cookie) {
        if self.order.len() == COOKIES_MAX
            && let Some(first) = self.order.pop_front()
        {
            self.cookies.remove(&first);
        }
        self.order.push_back(digest);
        self.cookies.insert(digest, cookie);
    }

    /// Whose time is not over, as the file has them.
    fn lines(&self, now: Instant) -> Vec<Line> {
        let known =
            self.order.iter().filter_map(|digest| Some((digest, self.cookies.get(digest)?)));
        known
            .filter(|(_, cookie)| now < cookie.until)
            .map(|(digest, &Cookie { token, until, .. })| Line {
                cookie: *digest,
                token,
                until_ms: wall_ms(until),
            })
            .collect()
    }
}

fn wall_ms(at: Instant) -> u64 {
    clock::wall_ns(at) / 1_000_000
}

fn caller(grant: &Grant) -> Caller {
    Caller { name: grant.name.clone(), scopes: grant.scopes, by_cookie: false }
}

fn too_many() -> Refused {
    Refused::new("gateway.limit", "too many wrong tokens from this address")
        .hint("wait a minute; who is let in already can still stop")
}

#[cfg(test)]
mod tests;

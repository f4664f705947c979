//! Who is calling: tokens as they are sent, and the cookies that stand for them in browsers.

use std::collections::{HashMap, VecDeque};
use std::net::{IpAddr, SocketAddr};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_link::clock;

use crate::message::{Proof, Refused, of_digits};
use crate::refusal::Refusal;
use crate::scope::Scopes;
use crate::token::{Grant, Token};

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
}

#[derive(Debug, Default)]
struct Inside {
    /// By digest, so that looking one up tells nothing of the others.
    cookies: HashMap<[u8; 32], (Caller, Instant)>,
    order: VecDeque<[u8; 32]>,
    once: Option<(Token, Caller)>,
    tries: VecDeque<(IpAddr, VecDeque<Instant>)>,
}

impl Door {
    /// A door that opens to these tokens, each for no more than `scopes`.
    #[must_use]
    pub fn new(mut grants: Vec<Grant>, scopes: Scopes, port: u16, secure: bool) -> Self {
        for grant in &mut grants {
            grant.scopes = grant.scopes.within(scopes);
        }
        let cookie = format!("polepair_{port}");
        Self { grants, cookie, secure, inside: Mutex::default() }
    }

    /// A new token that lets a browser in once, as whoever the first token is for. The one before it
    /// is good no more.
    ///
    /// # Errors
    /// When there is no randomness.
    pub fn once(&self) -> Result<Token, Refusal> {
        let token = Token::new()?;
        let caller = self.grants.first().map(caller);
        self.lock().once = caller.map(|caller| (token.clone(), caller));
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
                Some(caller) => Ok(caller),
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

    /// Lets a browser in by a token. Returns who it is and the cookie that says so.
    ///
    /// # Errors
    /// As [`who`](Self::who).
    pub fn login(&self, text: &str, peer: IpAddr) -> Result<(Caller, String), Refused> {
        self.may_try(peer)?;
        let given = Token::parse(text).and_then(|token| self.granted(&token));
        let caller = given.ok_or_else(|| self.wrong(peer))?;
        self.let_in(caller)
    }

    /// Lets a browser in by the token that is good once.
    ///
    /// # Errors
    /// As [`who`](Self::who).
    pub fn login_once(&self, text: &str, peer: IpAddr) -> Result<(Caller, String), Refused> {
        self.may_try(peer)?;
        let given = Token::parse(text);
        let taken = {
            let mut inside = self.lock();
            let is = |(once, _): &(Token, Caller)| given.as_ref().is_some_and(|g| g.is(once));
            if inside.once.as_ref().is_some_and(is) { inside.once.take() } else { None }
        };
        let (_, caller) = taken.ok_or_else(|| {
            self.wrong(peer).hint("it is good once: start the server again for another one")
        })?;
        self.let_in(caller)
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

    fn granted(&self, token: &Token) -> Option<Caller> {
        // All are compared, so that the time taken does not tell which.
        let found = self
            .grants
            .iter()
            .fold(None, |found, grant| if grant.token.is(token) { Some(grant) } else { found });
        found.map(caller)
    }

    fn known(&self, token: &Token) -> Option<Caller> {
        let inside = self.lock();
        let (caller, until) = inside.cookies.get(&token.digest())?;
        (clock::now() < *until).then(|| caller.clone())
    }

    fn let_in(&self, caller: Caller) -> Result<(Caller, String), Refused> {
        let token =
            Token::new().map_err(|error| Refused::new("gateway.busy", error.to_string()))?;
        let mut inside = self.lock();
        if inside.order.len() == COOKIES_MAX
            && let Some(first) = inside.order.pop_front()
        {
            inside.cookies.remove(&first);
        }
        inside.order.push_back(token.digest());
        let caller = Caller { by_cookie: true, ..caller };
        inside.cookies.insert(token.digest(), (caller.clone(), clock::now() + COOKIE_LASTS));
        let secure = if self.secure { "; Secure" } else { "" };
        let (name, value, lasts) = (&self.cookie, token.reveal(), COOKIE_LASTS.as_secs());
        let rest = format!("Path=/; Max-Age={lasts}; HttpOnly; SameSite=Strict{secure}");
        Ok((caller, format!("{name}={value}; {rest}")))
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

fn caller(grant: &Grant) -> Caller {
    Caller { name: grant.name.clone(), scopes: grant.scopes, by_cookie: false }
}

fn too_many() -> Refused {
    Refused::new("gateway.limit", "too many wrong tokens from this address")
        .hint("wait a minute; who is let in already can still stop")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scope::Scope;

    const PEER: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(192, 0, 2, 1));

    fn door() -> (Door, String) {
        let token = Token::new().unwrap();
        let text = token.reveal();
        let scopes: Scopes = "read,stop,move".parse().unwrap();
        let grant = Grant { token, scopes, name: "ann".into() };
        (Door::new(vec![grant], "read,move,raw".parse().unwrap(), 80, false), text)
    }

    #[test]
    fn a_token_and_its_cookie_grant_what_both_token_and_server_do() {
        let (door, text) = door();
        let bearer = format!("Bearer {text}");
        let caller = door.who(Some(&bearer), &[], PEER).unwrap();
        assert_eq!((&*caller.name, caller.by_cookie), ("ann", false));
        assert!(caller.scopes.allow(Scope::Move) && !caller.scopes.allow(Scope::Stop));
        let (_, cookie) = door.login(&text, PEER).unwrap();
        assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"));
        let pair = cookie.split(';').next().unwrap();
        let other = format!("other=1; {pair}");
        let inside = door.who(None, &[&other], PEER).unwrap();
        assert!(inside.by_cookie && inside.scopes == caller.scopes);
        assert!(door.who(None, &[&pair[..pair.len() - 1]], PEER).is_err());
        assert!(!cookie.contains(&text), "the cookie is not the token");
    }

    #[test]
    fn a_token_that_is_good_once_is_good_once() {
        let (door, text) = door();
        let once = door.once().unwrap().reveal();
        assert!(door.login_once(&text, PEER).is_err(), "the other token is not that");
        assert!(door.login_once(&once, PEER).is_ok());
        assert_eq!(door.login_once(&once, PEER).unwrap_err().code, "gateway.token");
    }

    #[test]
    fn wrong_tokens_are_counted_by_address_and_right_ones_still_stop() {
        let (door, text) = door();
        for _ in 0..TRIES_MAX {
            assert_eq!(door.login(&"0".repeat(64), PEER).unwrap_err().code, "gateway.token");
        }
        assert_eq!(door.login(&text, PEER).unwrap_err().code, "gateway.limit");
        let bearer = format!("Bearer {text}");
        assert!(door.who(Some(&bearer), &[], PEER).is_ok());
        assert_eq!(door.who(Some("Bearer x"), &[], PEER).unwrap_err().code, "gateway.limit");
        let other = IpAddr::V4(std::net::Ipv4Addr::new(192, 0, 2, 2));
        assert!(door.login(&text, other).is_ok());
    }

    #[test]
    fn browsers_are_let_in_up_to_a_number() {
        let (door, text) = door();
        let first = door.login(&text, PEER).unwrap().1;
        for _ in 0..COOKIES_MAX {
            door.login(&text, PEER).unwrap();
        }
        let pair = first.split(';').next().unwrap();
        assert!(door.who(None, &[pair], PEER).is_err());
        assert_eq!(door.lock().cookies.len(), COOKIES_MAX);
    }
}

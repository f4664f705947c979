//! Colours for dark and light terminals, and their replacements without colour.

use std::borrow::Cow;

use ratatui_core::style::{Color, Modifier, Style};
use ratatui_core::text::Span;

/// Role of a piece of text.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum TextRole {
    /// Nothing special.
    Plain,
    /// Less important, or old.
    Dim,
    /// More important.
    Strong,
    /// A good state.
    Good,
    /// To be looked at.
    Warn,
    /// Wrong.
    Bad,
    /// Sent by the host.
    ToDrive,
    /// A byte that changed.
    Changed,
    /// The key that stops.
    Stop,
}

/// With or without colours.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Theme {
    /// The terminal takes them, and the person wants them.
    pub colour: bool,
}

impl Theme {
    /// A piece of text.
    pub fn span<'a>(self, text: impl Into<Cow<'a, str>>, role: TextRole) -> Span<'a> {
        Span::styled(text, self.style(role))
    }

    /// Style of a role. The terminal's own colours for text and ground are left alone.
    pub fn style(self, role: TextRole) -> Style {
        let (colour, modifier) = match role {
            TextRole::Plain => (Color::Reset, Modifier::empty()),
            TextRole::Dim => (Color::Reset, Modifier::DIM),
            TextRole::Strong => (Color::Reset, Modifier::BOLD),
            TextRole::Good => (Color::Green, Modifier::empty()),
            TextRole::Warn => (Color::Magenta, Modifier::BOLD),
            TextRole::Bad => (Color::Red, Modifier::BOLD),
            TextRole::ToDrive => (Color::Cyan, Modifier::empty()),
            TextRole::Changed => (Color::Magenta, Modifier::BOLD.union(Modifier::UNDERLINED)),
            TextRole::Stop => (Color::Red, Modifier::BOLD.union(Modifier::REVERSED)),
        };
        let style = Style::new().add_modifier(modifier);
        if self.colour && colour != Color::Reset { style.fg(colour) } else { style }
    }
}

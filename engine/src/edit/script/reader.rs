//! Words of a script, and what may stand in them.

use glam::DVec3;

use super::{Coordinate, Place, ScriptError};

/// A word.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Word {
    /// Without quotes.
    pub(super) text: String,
    /// As it stands there.
    pub(super) raw: String,
    /// Where it begins.
    pub(super) place: Place,
}

/// The commands of a script, as words: at least one each.
pub(super) fn commands(script: &str) -> Result<Vec<Vec<Word>>, ScriptError> {
    let mut all = Vec::new();
    for (line, text) in script.lines().enumerate() {
        let characters: Vec<char> = text.chars().collect();
        let (mut words, mut at) = (Vec::new(), 0);
        while at < characters.len() {
            let place = Place { line: line + 1, column: at + 1 };
            match characters[at] {
                ';' => {
                    all.push(std::mem::take(&mut words));
                    at += 1;
                }
                c if c.is_whitespace() => at += 1,
                '#' if !is_color(&characters[at..]) => break,
                '"' => {
                    let length = characters[at + 1..].iter().position(|&c| c == '"').ok_or_else(|| ScriptError {
                        place,
                        found: "a quote that does not end".into(),
                        expected: "a second one on the same line".into(),
                    })?;
                    let text: String = characters[at + 1..at + 1 + length].iter().collect();
                    words.push(Word { raw: format!("\"{text}\""), text, place });
                    at += length + 2;
                }
                _ => {
                    let ends = |c: &char| c.is_whitespace() || *c == ';' || *c == '"';
                    let length = characters[at..].iter().position(ends).unwrap_or(characters.len() - at);
                    let text: String = characters[at..at + length].iter().collect();
                    words.push(Word { raw: text.clone(), text, place });
                    at += length;
                }
            }
        }
        all.push(words);
    }
    all.retain(|words| !words.is_empty());
    Ok(all)
}

/// Whether a `#` begins a colour and no comment: six hexadecimal digits, then the end of the word.
fn is_color(rest: &[char]) -> bool {
    let digits = rest.iter().skip(1).take_while(|c| c.is_ascii_hexdigit()).count();
    digits == 6 && rest.get(7).is_none_or(|c| c.is_whitespace() || *c == ';')
}

/// Reads the words of one command in order.
pub(super) struct Reader<'a> {
    words: &'a [Word],
    at: usize,
}

impl<'a> Reader<'a> {
    pub(super) fn new(words: &'a [Word]) -> Self {
        Self { words, at: 0 }
    }

    /// A mistake at the next word, or behind the last.
    pub(super) fn mistake(&self, expected: impl Into<String>) -> ScriptError {
        let end = |w: &Word| Place { line: w.place.line, column: w.place.column + w.raw.chars().count() };
        let (place, found) = match (self.words.get(self.at), self.words.last()) {
            (Some(word), _) => (word.place, format!("`{}`", word.raw)),
            (None, last) => (last.map_or(Place { line: 1, column: 1 }, end), "the end of the command".into()),
        };
        ScriptError { place, found, expected: expected.into() }
    }

    /// The next word, which is there.
    pub(super) fn word(&mut self, expected: &str) -> Result<&'a str, ScriptError> {
        let word = self.words.get(self.at).ok_or_else(|| self.mistake(expected))?;
        self.at += 1;
        Ok(&word.text)
    }

    /// What `read` makes of the next word.
    pub(super) fn value<T>(&mut self, expected: &str, read: impl FnOnce(&str) -> Option<T>) -> Result<T, ScriptError> {
        let found = self.words.get(self.at).and_then(|word| read(&word.text)).ok_or_else(|| self.mistake(expected))?;
        self.at += 1;
        Ok(found)
    }

    /// The next word, which is one of a list for people: `a, b or c`.
    pub(super) fn one_of(&mut self, list: &'static str) -> Result<&'static str, ScriptError> {
        self.value(list, |word| list.split([',', ' ']).find(|choice| *choice == word && *choice != "or"))
    }

    /// Takes the next word if it is this one.
    pub(super) fn takes(&mut self, word: &str) -> bool {
        let is_next = self.words.get(self.at).is_some_and(|w| w.text == word);
        self.at += usize::from(is_next);
        is_next
    }

    pub(super) fn is_done(&self) -> bool {
        self.at == self.words.len()
    }

    pub(super) fn number(&mut self, what: &str) -> Result<f64, ScriptError> {
        self.value(what, number)
    }

    pub(super) fn vector(&mut self, what: &str) -> Result<DVec3, ScriptError> {
        self.value(what, |text| numbers::<3>(text).map(DVec3::from_array))
    }
}

/// A finite number.
pub(super) fn number(text: &str) -> Option<f64> {
    text.parse().ok().filter(|v: &f64| v.is_finite())
}

/// N numbers with commas between them.
pub(super) fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let all: Vec<f64> = text.split(',').map(number).collect::<Option<_>>()?;
    all.try_into().ok()
}

/// `400,310` in pixels, `50%,40%` of the image.
pub(super) fn coordinates(text: &str) -> Option<[Coordinate; 2]> {
    let coordinate = |text: &str| match text.strip_suffix('%') {
        Some(percent) => number(percent).map(Coordinate::Percent),
        None => number(text).map(Coordinate::Pixels),
    };
    let (x, y) = text.split_once(',')?;
    Some([coordinate(x)?, coordinate(y)?])
}

/// One number for all three axes, or three with commas.
pub(super) fn factors(text: &str) -> Option<DVec3> {
    number(text).map(DVec3::splat).or_else(|| numbers(text).map(DVec3::from_array))
}

/// `3,7-12`.
pub(super) fn ranges(text: &str) -> Option<Vec<[u64; 2]>> {
    let range = |part: &str| match part.split_once('-') {
        None => part.parse().ok().map(|n| [n, n]),
        Some((a, b)) => Some([a.parse().ok()?, b.parse().ok()?]).filter(|[a, b]| a <= b),
    };
    text.split(',').map(range).collect()
}

/// `0.2..0.5`.
pub(super) fn span(text: &str) -> Option<[f64; 2]> {
    let (a, b) = text.split_once("..")?;
    Some([number(a)?, number(b)?])
}

/// `#ff8800`, red, green and blue from 0 to 1.
pub(super) fn color(text: &str) -> Option<DVec3> {
    let digits = text.strip_prefix('#').filter(|d| d.len() == 6 && d.bytes().all(|b| b.is_ascii_hexdigit()))?;
    let value = u32::from_str_radix(digits, 16).ok()?;
    Some(DVec3::from_array([16, 8, 0].map(|shift| f64::from(value >> shift & 255) / 255.0)))
}

/// `0.25+0.5t`, `2t`, `t`, `1-t`: `[offset, rate]`.
pub(super) fn linear(text: &str) -> Option<[f64; 2]> {
    let head = text.strip_suffix('t')?;
    // The sign in front of the rate: not the first character, and not the sign of an exponent.
    let mut signs = head.char_indices().filter(|&(i, c)| i > 0 && "+-".contains(c) && !head[..i].ends_with(['e', 'E']));
    let (offset, rate) = signs.next_back().map_or(("", head), |(i, _)| head.split_at(i));
    let rate = match rate.strip_suffix('*').unwrap_or(rate) {
        "" | "+" => 1.0,
        "-" => -1.0,
        rate => number(rate)?,
    };
    Some([if offset.is_empty() { 0.0 } else { number(offset)? }, rate]).filter(|[_, rate]| *rate != 0.0)
}

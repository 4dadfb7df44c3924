//! As much CBOR (RFC 8949, RFC 8746) as a client needs, by hand: what reads the service is not what the service writes with.

use serde::de::DeserializeOwned;

use pointmass::Real;

/// A number as it stands in JSON and in typed arrays.
pub(crate) trait Number: Real + DeserializeOwned {
    /// The tag of an array of these, little-endian.
    const TAG: u64;
    fn of(x: f64) -> Self;
    fn write(self, to: &mut Vec<u8>);
    fn read(bytes: &[u8]) -> Self;
}

macro_rules! number {
    ($type:ty, $tag:literal, $of:expr) => {
        impl Number for $type {
            const TAG: u64 = $tag;
            fn of(x: f64) -> Self {
                $of(x)
            }
            fn write(self, to: &mut Vec<u8>) {
                to.extend_from_slice(&self.to_le_bytes());
            }
            fn read(bytes: &[u8]) -> Self {
                Self::from_le_bytes(bytes.try_into().expect("as many bytes as one has"))
            }
        }
    };
}

#[expect(clippy::cast_possible_truncation, reason = "rounded to the nearest")]
fn rounded(x: f64) -> f32 {
    x as f32
}

number!(f32, 85, rounded);
number!(f64, 86, |x| x);

/// The tag of an array of unsigned integers of 64 bits, little-endian.
const IDS: u64 = 71;

fn head(major: u8, argument: u64) -> Vec<u8> {
    let major = major << 5;
    match (u8::try_from(argument), u32::try_from(argument)) {
        (Ok(argument), _) if argument < 24 => vec![major | argument],
        (_, Ok(argument)) => [&[major | 0x1a][..], &argument.to_be_bytes()].concat(),
        (_, Err(_)) => [&[major | 0x1b][..], &argument.to_be_bytes()].concat(),
    }
}

pub(crate) fn whole(number: u64) -> Vec<u8> {
    head(0, number)
}

pub(crate) fn float(number: f64) -> Vec<u8> {
    [&[0xfb][..], &number.to_be_bytes()].concat()
}

pub(crate) fn text(text: &str) -> Vec<u8> {
    [&head(3, text.len() as u64), text.as_bytes()].concat()
}

pub(crate) fn list(items: &[Vec<u8>]) -> Vec<u8> {
    [head(4, items.len() as u64), items.concat()].concat()
}

pub(crate) fn map<'a>(members: impl IntoIterator<Item = (&'a str, Vec<u8>)>) -> Vec<u8> {
    let members: Vec<_> = members.into_iter().map(|(name, value)| [text(name), value].concat()).collect();
    [head(5, members.len() as u64), members.concat()].concat()
}

/// Vectors as one typed array.
pub(crate) fn vectors<R: Number>(vectors: &[[R; 3]]) -> Vec<u8> {
    numbers(vectors.as_flattened())
}

pub(crate) fn numbers<R: Number>(numbers: &[R]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(size_of_val(numbers));
    for number in numbers {
        number.write(&mut bytes);
    }
    [head(6, R::TAG), head(2, bytes.len() as u64), bytes].concat()
}

pub(crate) fn ids(ids: &[u64]) -> Vec<u8> {
    let bytes: Vec<u8> = ids.iter().flat_map(|id| id.to_le_bytes()).collect();
    [head(6, IDS), head(2, bytes.len() as u64), bytes].concat()
}

/// A value that the service answers with.
#[derive(Debug, PartialEq)]
pub(crate) enum Value<'a> {
    Whole(u64),
    Float(f64),
    Text(&'a str),
    List(Vec<Self>),
    Map(Vec<(&'a str, Self)>),
    /// With its tag.
    Typed(u64, &'a [u8]),
    /// False, true, or null.
    Simple(u8),
}

impl<'a> Value<'a> {
    /// The only value of these bytes.
    pub(crate) fn of(mut bytes: &'a [u8]) -> Option<Self> {
        Self::next(&mut bytes).filter(|_| bytes.is_empty())
    }

    fn next(bytes: &mut &'a [u8]) -> Option<Self> {
        let (major, argument) = Self::head(bytes)?;
        let length = usize::try_from(argument).ok()?;
        Some(match (major >> 5, major & 31) {
            (0, _) => Self::Whole(argument),
            (3, _) => Self::Text(str::from_utf8(bytes.split_off(..length)?).ok()?),
            (4, _) => Self::List((0..length).map(|_| Self::next(bytes)).collect::<Option<_>>()?),
            (5, _) => {
                let member = |bytes: &mut &'a [u8]| {
                    let Self::Text(name) = Self::next(bytes)? else { return None };
                    Some((name, Self::next(bytes)?))
                };
                Self::Map((0..length).map(|_| member(bytes)).collect::<Option<_>>()?)
            }
            (6, _) => {
                let (major, length) = Self::head(bytes)?;
                Self::Typed(argument, bytes.split_off(..usize::try_from(length).ok()?).filter(|_| major >> 5 == 2)?)
            }
            (7, 26) => Self::Float(f32::from_bits(u32::try_from(argument).ok()?).into()),
            (7, 27) => Self::Float(f64::from_bits(argument)),
            (7, 20..=22) => Self::Simple(major & 31),
            _ => return None,
        })
    }

    /// The first byte of an item, and its argument.
    fn head(bytes: &mut &'a [u8]) -> Option<(u8, u64)> {
        let first = *bytes.split_off_first()?;
        let length = match first & 31 {
            small @ 0..24 => return Some((first, small.into())),
            power @ 24..28 => 1 << (power - 24),
            _ => return None,
        };
        let argument = bytes.split_off(..length)?;
        Some((first, argument.iter().fold(0, |argument, byte| argument << 8 | u64::from(*byte))))
    }

    pub(crate) fn member(&self, name: &str) -> Option<&Self> {
        let Self::Map(members) = self else { return None };
        members.iter().find_map(|(known, value)| (*known == name).then_some(value))
    }

    pub(crate) fn whole(&self) -> Option<u64> {
        if let Self::Whole(number) = self { Some(*number) } else { None }
    }

    pub(crate) fn float(&self) -> Option<f64> {
        if let Self::Float(number) = self { Some(*number) } else { None }
    }

    pub(crate) fn ids(&self) -> Option<Vec<u64>> {
        let Self::Typed(IDS, bytes) = self else { return None };
        let (ids, []) = bytes.as_chunks() else { return None };
        Some(ids.iter().map(|id| u64::from_le_bytes(*id)).collect())
    }

    pub(crate) fn vectors<R: Number>(&self) -> Option<Vec<[R; 3]>> {
        let Self::Typed(tag, bytes) = self else { return None };
        let numbers: Vec<R> = bytes.chunks(size_of::<R>()).map(R::read).collect();
        let (vectors, rest) = numbers.as_chunks();
        (*tag == R::TAG && rest.is_empty()).then(|| vectors.to_vec())
    }
}

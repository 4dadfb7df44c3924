//! Strict CBOR in (RFC 8949), read into the shapes that JSON has, and typed arrays (RFC 8746) as columns.
//!
//! Nothing is allocated by a length that is only declared, and nothing recurses as deep as a body is nested: values are
//! read by their types, which are a few levels deep, and what no type asks for is walked over.

#![expect(
    clippy::wildcard_enum_match_arm,
    reason = "a few of the types of CBOR are read, all others are refused alike"
)]

use std::borrow::Cow;
use std::fmt;

use minicbor::data::Type;
use minicbor::decode::Decoder;
use serde::de::{Deserialize, DeserializeSeed, Deserializer, Error as _, MapAccess, SeqAccess, Visitor};
use serde::forward_to_deserialize_any;

use crate::column::Column;
use crate::real::Real;
use crate::server::body::RAW;
use crate::server::json::{Element, explain, member};
use crate::server::memory::{ITEM_BYTES, NUMBER_ITEM_BYTES};
use crate::server::problem::{Code, Problem};

/// Deeper than any request is.
const LEVELS_MAX: usize = 32;

/// Tag 55799: says that what follows is CBOR, and nothing else.
const MARK: [u8; 3] = [0xd9, 0xd9, 0xf7];

/// A body without the mark that some encoders begin with.
pub(crate) fn without_mark(body: &[u8]) -> &[u8] {
    body.strip_prefix(&MARK).unwrap_or(body)
}

/// Reads one value; `prefix` is the pointer to it. What is not CBOR at all is [`Code::MalformedCbor`], what is the wrong
/// CBOR says where.
pub(crate) fn read<'a, T: Deserialize<'a>>(bytes: &'a [u8], prefix: &str) -> Result<T, Problem> {
    let mut items = Items::new(bytes);
    T::deserialize(&mut items)
        .and_then(|value| items.end().map(|()| value))
        .map_err(|fault| items.refusal(&fault, prefix))
}

/// Whether a value is text.
pub(crate) fn is_text(bytes: &[u8]) -> bool {
    matches!(Decoder::new(bytes).datatype(), Ok(Type::String | Type::StringIndef))
}

/// Whether a value is a list.
pub(crate) fn is_list(bytes: &[u8]) -> bool {
    matches!(Decoder::new(bytes).datatype(), Ok(Type::Array | Type::ArrayIndef))
}

/// Whether a value is a list that begins with a list, with null, or not at all.
pub(crate) fn is_list_of_lists(bytes: &[u8]) -> bool {
    let mut decoder = Decoder::new(bytes);
    match decoder.array() {
        Ok(Some(0)) => true,
        Ok(_) => {
            let first = decoder.datatype();
            matches!(first, Ok(Type::Array | Type::ArrayIndef | Type::Tag | Type::Null | Type::Break))
        }
        Err(_) => false,
    }
}

/// The numbers of a value that is a typed array.
pub(crate) fn typed_array(bytes: &[u8]) -> Option<TypedArray<'_>> {
    let mut items = Items::new(bytes);
    match items.decoder.datatype() {
        Ok(Type::Tag) => items.tagged().ok().filter(|_| items.rest() == 0),
        Ok(_) | Err(_) => None,
    }
}

/// Why something is not read.
#[derive(Debug)]
pub(crate) enum Fault {
    /// It is not CBOR.
    Malformed(String),
    /// It is not what is asked for.
    Wrong(String),
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (Self::Malformed(reason) | Self::Wrong(reason)) = self;
        f.write_str(reason)
    }
}

impl std::error::Error for Fault {}

impl serde::de::Error for Fault {
    fn custom<T: fmt::Display>(reason: T) -> Self {
        Self::Wrong(reason.to_string())
    }
}

/// The decoder is only asked for what the first byte of an item says: what it cannot read then is malformed.
impl From<minicbor::decode::Error> for Fault {
    fn from(error: minicbor::decode::Error) -> Self {
        Self::Malformed(error.to_string())
    }
}

fn malformed(reason: impl Into<String>) -> Fault {
    Fault::Malformed(reason.into())
}

/// What is in a body, counted before any of it takes memory.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Census {
    pub(crate) objects: u64,
    /// Numbers outside of typed arrays.
    numbers: u64,
    /// What is neither, names of members too.
    others: u64,
    /// What strings of bytes can become.
    from_bytes: u64,
}

impl Census {
    /// Of a body, up to where it is no longer CBOR.
    pub(crate) fn of(body: &[u8]) -> Self {
        let mut census = Self::default();
        let _malformed = Items::new(without_mark(body)).walk(&mut census);
        census
    }

    /// The most bytes that it is read into, besides its objects.
    pub(crate) fn bytes(&self) -> u64 {
        self.numbers * NUMBER_ITEM_BYTES + self.others * ITEM_BYTES + self.from_bytes
    }
}

/// What is left of a list or an object.
#[derive(Debug, Clone, Copy)]
enum Left {
    /// So many values, a name being one.
    Count(u64),
    /// All up to a break, which stands where a list goes on or an object has a name.
    UntilBreak { is_object: bool, may_end: bool },
}

/// The items of a body, one of which is next.
struct Items<'a> {
    decoder: Decoder<'a>,
    /// The pointer to what could not be read, its last part first.
    trail: Vec<String>,
}

impl<'a> Items<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { decoder: Decoder::new(bytes), trail: Vec::new() }
    }

    fn rest(&self) -> usize {
        self.decoder.input().len() - self.decoder.position()
    }

    /// Passes over an item of one byte.
    fn pass(&mut self) {
        self.decoder.set_position(self.decoder.position() + 1);
    }

    /// Why it is not read.
    fn refusal(&self, fault: &Fault, prefix: &str) -> Problem {
        let mut all = Items::new(self.decoder.input());
        if let Err(Fault::Malformed(reason)) = all.walk(&mut Census::default()).and_then(|()| all.end()) {
            return Problem::new(Code::MalformedCbor, format!("the body is not CBOR: {reason}"));
        }
        let trail: String = self.trail.iter().rev().map(String::as_str).collect();
        explain(fault.to_string(), &format!("{prefix}{trail}"))
    }

    /// Notes that the member whose name is here could not be read.
    fn leave_member(&mut self, at: usize) {
        let mut name = Decoder::new(&self.decoder.input()[at..]);
        let name: Result<String, _> = name.str_iter().and_then(Iterator::collect);
        self.trail.extend(name.map(|name| member(&name)));
    }

    /// Refuses what stands behind the value.
    fn end(&self) -> Result<(), Fault> {
        match self.rest() {
            0 => Ok(()),
            rest => Err(malformed(format!("{rest} bytes are left behind its end"))),
        }
    }

    /// Passes over the next value, however deep it is, and counts what is in it.
    fn walk(&mut self, census: &mut Census) -> Result<(), Fault> {
        let mut outer = [Left::Count(0); LEVELS_MAX];
        let mut level = 0;
        let mut left = Left::Count(1);
        loop {
            let is_complete = match left {
                Left::Count(count) => count == 0,
                Left::UntilBreak { may_end, .. } => {
                    let ends = may_end && self.decoder.datatype()? == Type::Break;
                    if ends {
                        self.pass();
                    }
                    ends
                }
            };
            if is_complete {
                match level {
                    0 => return Ok(()),
                    _ => level -= 1,
                }
                left = outer[level];
                continue;
            }
            match &mut left {
                Left::Count(count) => *count -= 1,
                Left::UntilBreak { is_object, may_end } => *may_end = !(*is_object && *may_end),
            }
            if let Some(inner) = self.head(census)? {
                let deeper = || Fault::custom(format_args!("it is nested deeper than {LEVELS_MAX} levels"));
                *outer.get_mut(level).ok_or_else(deeper)? = left;
                level += 1;
                left = inner;
            }
        }
    }

    /// Passes over a value that has no others in it, or over the head of one that has.
    fn head(&mut self, census: &mut Census) -> Result<Option<Left>, Fault> {
        let mut width = None;
        while self.decoder.datatype()? == Type::Tag {
            width = Kind::of(self.decoder.tag()?.as_u64()).map(|kind| kind.width);
        }
        let decoder = &mut self.decoder;
        match decoder.datatype()? {
            Type::U8 | Type::U16 | Type::U32 | Type::U64 | Type::I8 | Type::I16 | Type::I32 | Type::I64 | Type::Int => {
                census.numbers += 1;
                decoder.int()?;
            }
            Type::F16 | Type::F32 | Type::F64 => {
                census.numbers += 1;
                self.float()?;
            }
            Type::Map => {
                census.objects += 1;
                return Ok(decoder.map()?.map(|count| Left::Count(count.saturating_mul(2))));
            }
            Type::MapIndef => {
                census.objects += 1;
                self.pass();
                return Ok(Some(Left::UntilBreak { is_object: true, may_end: true }));
            }
            Type::Array => {
                census.others += 1;
                return Ok(decoder.array()?.map(Left::Count));
            }
            Type::ArrayIndef => {
                census.others += 1;
                self.pass();
                return Ok(Some(Left::UntilBreak { is_object: false, may_end: true }));
            }
            Type::String | Type::StringIndef => {
                census.others += 1;
                decoder.str_iter()?.try_for_each(|part| part.map(|_| ()))?;
            }
            Type::Bytes | Type::BytesIndef => {
                census.others += 1;
                for part in decoder.bytes_iter()? {
                    // Parts are joined, and in a column a number can have 16 bytes.
                    census.from_bytes += part?.len() as u64 * (1 + width.map_or(0, |width| 16 / width as u64));
                }
            }
            Type::Bool | Type::Null | Type::Undefined => {
                census.others += 1;
                self.pass();
            }
            Type::Simple => {
                census.others += 1;
                self.simple()?;
            }
            Type::Break => return Err(malformed("a break stands where a value should")),
            Type::Tag => unreachable!("passed over above"),
            Type::Unknown(byte) => return Err(malformed(format!("{byte:#04x} begins no value"))),
        }
        Ok(None)
    }

    /// A simple value has one way to be written.
    fn simple(&mut self) -> Result<(), Fault> {
        let at = self.decoder.position();
        match self.decoder.simple()? {
            value if value < 32 && self.decoder.position() - at == 2 => {
                Err(malformed(format!("the simple value {value} has two bytes")))
            }
            _ => Ok(()),
        }
    }

    fn item(&mut self) -> Result<Item<'a>, Fault> {
        if let Some(number) = self.number()? {
            return Ok(Item::Number(number));
        }
        Ok(match self.decoder.datatype()? {
            Type::Bool => Item::Bool(self.decoder.bool()?),
            Type::Null => {
                self.pass();
                Item::Null
            }
            Type::String => Item::Text(self.decoder.str()?),
            Type::StringIndef => Item::TextInParts(self.decoder.str_iter()?.collect::<Result<_, _>>()?),
            Type::Bytes => Item::Bytes(self.decoder.bytes()?),
            Type::Array | Type::ArrayIndef => Item::List(self.decoder.array()?),
            Type::Map | Type::MapIndef => Item::Object(self.decoder.map()?),
            Type::Tag => Item::Typed(self.tagged()?),
            Type::Undefined => {
                return Err(Fault::custom("undefined is no value here; where there is none, write null"));
            }
            Type::Simple => return Err(Fault::custom("of simple values only false, true and null are read")),
            Type::BytesIndef => {
                return Err(Fault::custom("a string of bytes in parts is read in a typed array only"));
            }
            kind => return Err(malformed(format!("{kind} begins no value"))),
        })
    }

    fn number(&mut self) -> Result<Option<Number>, Fault> {
        Ok(Some(match self.decoder.datatype()? {
            Type::U8 | Type::U16 | Type::U32 | Type::U64 => Number::Whole(self.decoder.u64()?),
            Type::I8 | Type::I16 | Type::I32 | Type::I64 | Type::Int => Number::Negative(self.decoder.int()?.into()),
            Type::F16 | Type::F32 | Type::F64 => Number::Float(self.float()?),
            _ => return Ok(None),
        }))
    }

    /// A float of any width. Halves are taken apart here: for them minicbor would bring three crates.
    fn float(&mut self) -> Result<f64, Fault> {
        let at = self.decoder.position();
        if self.decoder.datatype()? != Type::F16 {
            return Ok(self.decoder.f64()?);
        }
        let Some([high, low]) = self.decoder.input().get(at + 1..).and_then(<[u8]>::first_chunk) else {
            return Err(malformed("it ends within a number"));
        };
        self.decoder.set_position(at + 3);
        Ok(half(u16::from_be_bytes([*high, *low])))
    }

    fn tagged(&mut self) -> Result<TypedArray<'a>, Fault> {
        let tag = self.decoder.tag()?.as_u64();
        let Some(kind) = Kind::of(tag) else {
            let detail = "typed arrays have one of 64 to 67, 69 to 71, 81, 82, 85 and 86, and nothing else has one";
            return Err(Fault::custom(format_args!("tag {tag} is not read: {detail}")));
        };
        let bytes = match self.decoder.datatype()? {
            Type::Bytes => Cow::Borrowed(self.decoder.bytes()?),
            Type::BytesIndef => Cow::Owned(self.decoder.bytes_iter()?.collect::<Result<Vec<_>, _>>()?.concat()),
            _ => {
                return Err(Fault::custom(format_args!(
                    "tag {tag} stands before something else than a string of bytes"
                )));
            }
        };
        if !bytes.len().is_multiple_of(kind.width) {
            let (len, width) = (bytes.len(), kind.width);
            return Err(Fault::custom(format_args!("a typed array has {len} bytes, and numbers of {width}")));
        }
        Ok(TypedArray { kind, bytes })
    }
}

/// The number that the 16 bits of a float stand for.
fn half(bits: u16) -> f64 {
    let (exponent, mantissa) = ((bits >> 10) & 31, f64::from(bits & 1023));
    let magnitude = match exponent {
        0 => mantissa / 16_777_216.0,
        31 if mantissa == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1.0 + mantissa / 1024.0) * f64::from(1_u32 << exponent) / 32_768.0,
    };
    if bits >> 15 == 1 { -magnitude } else { magnitude }
}

/// What is next: a value, or the head of one that has others in it, with how many, if that is said.
enum Item<'a> {
    Number(Number),
    Bool(bool),
    Null,
    Text(&'a str),
    TextInParts(String),
    Bytes(&'a [u8]),
    List(Option<u64>),
    Object(Option<u64>),
    Typed(TypedArray<'a>),
}

/// Reads a value by what it is to become; what it becomes refuses what it cannot be.
impl<'de> Deserializer<'de> for &mut Items<'de> {
    type Error = Fault;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match self.item()? {
            Item::Number(number) => number.deserialize_any(visitor),
            Item::Bool(value) => visitor.visit_bool(value),
            Item::Null => visitor.visit_unit(),
            Item::Text(text) => visitor.visit_borrowed_str(text),
            Item::TextInParts(text) => visitor.visit_string(text),
            Item::Bytes(bytes) => visitor.visit_borrowed_bytes(bytes),
            Item::List(left) => {
                let mut listed = Listed { items: self, left, last: 0 };
                let value = visitor.visit_seq(&mut listed)?;
                listed.end().map(|()| value)
            }
            Item::Object(left) => {
                let mut listed = Listed { items: self, left, last: 0 };
                let value = visitor.visit_map(&mut listed)?;
                listed.end().map(|()| value)
            }
            Item::Typed(array) => visitor.visit_seq(TypedItems { array, next: 0, trail: &mut self.trail }),
        }
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match self.number()? {
            Some(number) => number.deserialize_f64(visitor),
            None => self.deserialize_any(visitor),
        }
    }

    fn deserialize_f32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match self.number()? {
            Some(number) => number.deserialize_f32(visitor),
            None => self.deserialize_any(visitor),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        if self.decoder.datatype()? == Type::Null {
            self.pass();
            return visitor.visit_none();
        }
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(self, name: &'static str, visitor: V) -> Result<V::Value, Fault> {
        if name != RAW {
            return visitor.visit_newtype_struct(self);
        }
        let from = self.decoder.position();
        self.walk(&mut Census::default())?;
        visitor.visit_borrowed_bytes(&self.decoder.input()[from..self.decoder.position()])
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        self.walk(&mut Census::default())?;
        visitor.visit_unit()
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 char str string bytes byte_buf unit unit_struct seq tuple
        tuple_struct map struct enum identifier
    }
}

/// The values of a list, or the members of an object.
struct Listed<'i, 'de> {
    items: &'i mut Items<'de>,
    /// `None`: up to a break.
    left: Option<u64>,
    /// After the last value of a list, how many there were; the place of the last name of an object.
    last: usize,
}

impl Listed<'_, '_> {
    fn has_next(&mut self) -> Result<bool, Fault> {
        match &mut self.left {
            Some(0) => return Ok(false),
            Some(left) => *left -= 1,
            None if self.items.decoder.datatype()? == Type::Break => {
                self.items.pass();
                self.left = Some(0);
                return Ok(false);
            }
            None => {}
        }
        Ok(true)
    }

    fn end(mut self) -> Result<(), Fault> {
        if self.has_next()? { Err(Fault::custom("there is more in it than is taken")) } else { Ok(()) }
    }

    /// A length may say what is not there.
    fn len(&self) -> Option<usize> {
        self.left.map(|left| usize::try_from(left).map_or(self.items.rest(), |left| left.min(self.items.rest())))
    }
}

impl<'de> SeqAccess<'de> for &mut Listed<'_, 'de> {
    type Error = Fault;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, Fault> {
        if !self.has_next()? {
            return Ok(None);
        }
        self.last += 1;
        seed.deserialize(&mut *self.items)
            .map(Some)
            .inspect_err(|_| self.items.trail.push(format!("/{}", self.last - 1)))
    }

    fn size_hint(&self) -> Option<usize> {
        self.len()
    }
}

impl<'de> MapAccess<'de> for &mut Listed<'_, 'de> {
    type Error = Fault;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, Fault> {
        if !self.has_next()? {
            return Ok(None);
        }
        match self.items.decoder.datatype()? {
            Type::String | Type::StringIndef => {
                self.last = self.items.decoder.position();
                seed.deserialize(&mut *self.items).map(Some).inspect_err(|_| self.items.leave_member(self.last))
            }
            kind => Err(Fault::custom(format_args!("the name of a member is text; this one is {kind}"))),
        }
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, Fault> {
        seed.deserialize(&mut *self.items).inspect_err(|_| self.items.leave_member(self.last))
    }

    fn size_hint(&self) -> Option<usize> {
        self.len()
    }
}

/// A number, which becomes one of the precision it is read in, to the nearest.
#[derive(Debug, Clone, Copy)]
enum Number {
    Whole(u64),
    Negative(i128),
    Float(f64),
}

impl Number {
    #[expect(clippy::cast_precision_loss, reason = "the nearest")]
    fn nearest(self) -> f64 {
        match self {
            Self::Whole(x) => x as f64,
            Self::Negative(x) => x as f64,
            Self::Float(x) => x,
        }
    }

    fn double(self) -> Result<f64, Fault> {
        let x = self.nearest();
        if x.is_finite() { Ok(x) } else { Err(self.out_of_range()) }
    }

    #[expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "the nearest, rounded once")]
    fn single(self) -> Result<f32, Fault> {
        let x = match self {
            Self::Whole(x) => x as f32,
            Self::Negative(x) => x as f32,
            Self::Float(x) => x as f32,
        };
        if x.is_finite() { Ok(x) } else { Err(self.out_of_range()) }
    }

    fn out_of_range(self) -> Fault {
        Fault::custom(format_args!("number out of range: {:e}", self.nearest()))
    }
}

impl<'de> Deserializer<'de> for Number {
    type Error = Fault;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match self {
            Self::Whole(x) => visitor.visit_u64(x),
            Self::Negative(x) if let Ok(x) = i64::try_from(x) => visitor.visit_i64(x),
            Self::Negative(_) | Self::Float(_) => visitor.visit_f64(self.double()?),
        }
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        visitor.visit_f64(self.double()?)
    }

    fn deserialize_f32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        visitor.visit_f32(self.single()?)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        visitor.visit_some(self)
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 char str string bytes byte_buf unit unit_struct newtype_struct seq
        tuple tuple_struct map struct enum identifier ignored_any
    }
}

/// How the numbers of a typed array are written.
#[derive(Debug, Clone, Copy)]
struct Kind {
    is_float: bool,
    /// Bytes of a number.
    width: usize,
    is_little: bool,
}

impl Kind {
    fn of(tag: u64) -> Option<Self> {
        let whole = |width, is_little| Some(Self { is_float: false, width, is_little });
        let float = |width, is_little| Some(Self { is_float: true, width, is_little });
        match tag {
            64 => whole(1, false),
            65 => whole(2, false),
            66 => whole(4, false),
            67 => whole(8, false),
            69 => whole(2, true),
            70 => whole(4, true),
            71 => whole(8, true),
            81 => float(4, false),
            82 => float(8, false),
            85 => float(4, true),
            86 => float(8, true),
            _ => None,
        }
    }
}

/// Numbers one behind the other, as a machine has them.
#[derive(Debug)]
pub(crate) struct TypedArray<'a> {
    kind: Kind,
    bytes: Cow<'a, [u8]>,
}

impl TypedArray<'_> {
    fn get(&self, index: usize) -> Option<Number> {
        let Kind { is_float, width, is_little } = self.kind;
        let bytes = self.bytes.get(index * width..(index + 1) * width)?;
        let mut little = [0; 8];
        for (k, byte) in bytes.iter().enumerate() {
            little[if is_little { k } else { width - 1 - k }] = *byte;
        }
        let bits = u64::from_le_bytes(little);
        Some(match (is_float, u32::try_from(bits)) {
            (true, Ok(bits)) if width == 4 => Number::Float(f32::from_bits(bits).into()),
            (true, _) => Number::Float(f64::from_bits(bits)),
            (false, _) => Number::Whole(bits),
        })
    }

    /// A column, in one pass: one vector alone is for all. What is not finite in it the engine finds.
    pub(crate) fn column<E: Element>(&self) -> Result<Column<E::Value>, String> {
        let nearest = |x: f64| E::Number::nearest(x);
        match self.kind {
            Kind { is_float: true, width: 4, is_little: true } => {
                self.rows::<E, 4>(|bytes| nearest(f32::from_le_bytes(bytes).into()))
            }
            Kind { is_float: true, width: 4, is_little: false } => {
                self.rows::<E, 4>(|bytes| nearest(f32::from_be_bytes(bytes).into()))
            }
            Kind { is_float: true, is_little: true, .. } => {
                self.rows::<E, 8>(|bytes| nearest(f64::from_le_bytes(bytes)))
            }
            Kind { is_float: true, is_little: false, .. } => {
                self.rows::<E, 8>(|bytes| nearest(f64::from_be_bytes(bytes)))
            }
            Kind { is_float: false, .. } => {
                Err("a typed array of these is one of floats: tag 81, 82, 85 or 86".to_owned())
            }
        }
    }

    fn rows<E: Element, const N: usize>(
        &self,
        number: impl Fn([u8; N]) -> E::Number,
    ) -> Result<Column<E::Value>, String> {
        let row = E::NUMBERS * N;
        let value = |row: &[u8]| {
            let (numbers, _) = row.as_chunks::<N>();
            E::of(|k| number(numbers[k]))
        };
        if !self.bytes.len().is_multiple_of(row) {
            let count = self.bytes.len() / N;
            return Err(format!("a typed array of these has {} numbers for each; it has {count}", E::NUMBERS));
        }
        if E::NUMBERS > 1 && self.bytes.len() == row {
            return Ok(Column::Uniform(value(&self.bytes)));
        }
        Ok(Column::PerParticle(self.bytes.chunks_exact(row).map(value).collect()))
    }
}

/// A typed array where a list is read value by value.
struct TypedItems<'i, 'a> {
    array: TypedArray<'a>,
    next: usize,
    trail: &'i mut Vec<String>,
}

impl<'de> SeqAccess<'de> for TypedItems<'_, '_> {
    type Error = Fault;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, Fault> {
        let Some(number) = self.array.get(self.next) else { return Ok(None) };
        self.next += 1;
        seed.deserialize(number).map(Some).inspect_err(|_| self.trail.push(format!("/{}", self.next - 1)))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.array.bytes.len() / self.array.kind.width - self.next)
    }
}

#[cfg(test)]
mod tests {
    use super::{Census, Code, LEVELS_MAX, half, read};
    use crate::column::Column;
    use crate::server::body::Raw;
    use crate::server::json::{Object, Vector, column};
    use serde::Deserialize;
    use serde::de::IgnoredAny;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Body {
        #[expect(dead_code, reason = "only read")]
        mass: f64,
    }

    /// `mass` as the only member, with this value.
    fn mass(value: &[u8]) -> Vec<u8> {
        [b"\xa1\x64mass", value].concat()
    }

    #[test]
    fn what_is_wrong_is_told_with_its_place() {
        for (body, code, pointer) in [
            (vec![], Code::MalformedCbor, None),
            (b"\xa1\x64mass".to_vec(), Code::MalformedCbor, None),
            (mass(b"\x01\x01"), Code::MalformedCbor, None),
            (mass(b"\xfb\x00"), Code::MalformedCbor, None),
            (mass(b"\x61\xff"), Code::MalformedCbor, None),
            // The wrong thing first, and then no CBOR at all.
            (b"\xa2\x64mass\x60\x61".to_vec(), Code::MalformedCbor, None),
            (b"\xbf\x64mass\xff".to_vec(), Code::MalformedCbor, None),
            (b"\x81\x01".to_vec(), Code::InvalidField, Some("")),
            (b"\x01".to_vec(), Code::InvalidField, Some("")),
            (mass(b"\x61\x31"), Code::InvalidField, Some("/mass")),
            (mass(b"\x41\x31"), Code::InvalidField, Some("/mass")),
            (mass(b"\xf6"), Code::InvalidField, Some("/mass")),
            (mass(b"\xf7"), Code::InvalidField, Some("/mass")),
            (mass(b"\xc1\x01"), Code::InvalidField, Some("/mass")),
            (mass(b"\xf9\x7e\x00"), Code::NotFinite, Some("/mass")),
            (b"\xa2\x64mass\x01\x64mass\x01".to_vec(), Code::DuplicateField, Some("/mass")),
            (b"\xa2\x64mass\x01\x63a/b\x01".to_vec(), Code::UnknownField, Some("/a~1b")),
            (b"\xa1\x01\x01".to_vec(), Code::InvalidField, Some("")),
            (b"\xa0".to_vec(), Code::MissingField, Some("/mass")),
        ] {
            let problem = read::<Object<Body>>(&body, "").expect_err("not a body");
            assert_eq!((problem.code, problem.pointer.as_deref()), (code, pointer), "{body:02x?}: {}", problem.detail);
        }
        for body in [mass(b"\x01"), b"\xbf\x7f\x62ma\x62ss\xff\x20\xff".to_vec()] {
            read::<Object<Body>>(&body, "").expect("a body");
        }
    }

    #[test]
    fn a_column_is_one_value_or_a_list() {
        let vector = |bytes| column::<Vector<f64>>(Raw::Cbor(bytes), "position");
        assert_eq!(vector(b"\x83\x01\x02\x03").expect("one"), Column::Uniform([1.0, 2.0, 3.0].into()));
        let listed = Column::PerParticle(vec![[1.0, 2.0, 3.0].into()]);
        assert_eq!(vector(b"\x81\x83\x01\x02\x03").expect("a list"), listed);
        assert_eq!(vector(b"\x9f\x9f\x01\x02\x03\xff\xff").expect("a list"), listed);
        assert_eq!(vector(b"\x81\xd8\x40\x43\x01\x02\x03").expect("a list of typed arrays"), listed);
        assert_eq!(vector(b"\x80").expect("an empty list"), Column::PerParticle(vec![]));
        assert_eq!(vector(b"\x9f\xff").expect("an empty list"), Column::PerParticle(vec![]));
        let own = column::<Option<Vector<f64>>>(Raw::Cbor(b"\x82\xf6\x83\x01\x02\x03"), "acceleration");
        assert_eq!(own.expect("a list with null"), Column::PerParticle(vec![None, Some([1.0, 2.0, 3.0].into())]));
        for (bytes, pointer) in [
            (&b"\x82\x01\x02"[..], "/position"),
            (b"\x82\x83\x01\x02\x03\x84\x01\x02\x03\x04", "/position/1"),
            (b"\x81\x83\x01\x02\x61\x33", "/position/0/2"),
        ] {
            assert_eq!(vector(bytes).expect_err("no column").pointer.as_deref(), Some(pointer), "{bytes:02x?}");
        }
    }

    #[test]
    fn what_no_type_asks_for_is_passed_over_as_a_whole() {
        for good in [
            &b"\x00"[..],
            b"\xa2\x01\x02\xf7\xd9\xff\xff\x80",
            b"\xbf\x01\x9f\xff\x5f\x41\x00\xff\x02\xff",
            b"\x9f\xbf\xff\x81\x9f\xff\xff",
            b"\x7f\xff",
            b"\xf8\x20",
        ] {
            read::<IgnoredAny>(good, "").unwrap_or_else(|problem| panic!("{good:02x?}: {problem:?}"));
        }
        for bad in [
            &b"\xff"[..],
            b"\xbf\x01\xff",
            b"\x81\xff",
            b"\xc1\xff",
            b"\xa1\x01",
            b"\x5f\x5f\x41\x00\xff\xff",
            b"\x7f\x41\x00\xff",
            b"\x1f",
            b"\xdf\x00",
            b"\xf8\x1f",
            b"\x9f\x00",
        ] {
            assert_eq!(read::<IgnoredAny>(bad, "").expect_err("malformed").code, Code::MalformedCbor, "{bad:02x?}");
        }
        let nested = |levels: usize| [vec![0x81; levels], vec![0]].concat();
        read::<IgnoredAny>(&nested(LEVELS_MAX), "").expect("as deep as it may be");
        assert_eq!(read::<IgnoredAny>(&nested(LEVELS_MAX + 1), "").expect_err("deeper").code, Code::InvalidField);
    }

    #[test]
    fn a_census_counts_what_is_there_and_not_what_is_said_to_be() {
        let census = Census::of(b"\x83\xa0\xbf\x61a\xa1\x61b\xf6\xff\x9b\x10\x00\x00\x00\x00\x00\x00\x00\xa0");
        assert_eq!(census.objects, 4);
        // Bytes that look like objects are none in a typed array, which takes a few times its own length.
        let typed = [b"\xd8\x56\x59\x10\x00".to_vec(), vec![0xa0; 4096]].concat();
        let census = Census::of(&typed);
        assert_eq!(census.objects, 0);
        assert!((2 * 4096..4 * 4096).contains(&census.bytes()), "{}", census.bytes());
    }

    /// Moved into the bits of a single, a half is too small by 2¹¹².
    #[test]
    fn halves_are_the_numbers_that_singles_say() {
        const TWO_112: f64 = f64::from_bits((1023 + 112) << 52);
        for bits in 0..=u16::MAX {
            let single = f32::from_bits(u32::from(bits & 0x7fff) << 13 | u32::from(bits >> 15) << 31);
            let expected = match bits & 0x7fff {
                0x7c00 => f64::from(single.signum()) * f64::INFINITY,
                0x7c01.. => f64::NAN,
                _ => f64::from(single) * TWO_112,
            };
            let read = half(bits);
            assert!(read.to_bits() == expected.to_bits() || (read.is_nan() && expected.is_nan()), "{bits:#06x}");
        }
    }
}

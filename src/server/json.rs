//! Strict JSON in, exact JSON out.

use std::fmt;
use std::marker::PhantomData;

use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserialize, DeserializeOwned, Deserializer, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde::ser::{Serialize, Serializer};
use serde_path_to_error::{Path, Segment};
use utoipa::openapi::schema::{ObjectBuilder, Schema, Type};

use crate::column::Column;
use crate::forces::Drag;
use crate::real::Real;
use crate::server::body::Raw;
use crate::server::columns::Columns;
use crate::server::content::AnyColumns;
use crate::server::problem::{Code, Problem};
use crate::world::World;

/// A number type that JSON can carry: read from its digits straight into its precision, written with the fewest digits
/// that read back as the same number.
pub(crate) trait WireReal: Real + Serialize + Element<Value = Self, Number = Self> {
    /// The tag of an array of these, little-endian (RFC 8746).
    const TYPED_ARRAY: u64;
    fn any_columns(world: World<Self>, columns: Columns<Self>) -> AnyColumns;
}

impl WireReal for f32 {
    const TYPED_ARRAY: u64 = 85;
    fn any_columns(world: World<Self>, columns: Columns<Self>) -> AnyColumns {
        AnyColumns::Single(world, columns)
    }
}

impl WireReal for f64 {
    const TYPED_ARRAY: u64 = 86;
    fn any_columns(world: World<Self>, columns: Columns<Self>) -> AnyColumns {
        AnyColumns::Double(world, columns)
    }
}

/// The text of a body.
pub(crate) fn text(body: &[u8]) -> Result<&str, Problem> {
    std::str::from_utf8(body)
        .map_err(|error| Problem::new(Code::MalformedJson, format!("the body is not UTF-8: {error}")))
}

/// Reads one value; `prefix` is the pointer to it. What is not JSON at all is [`Code::MalformedJson`], what is the wrong
/// JSON says where.
pub(crate) fn parse_part<'a, T: Deserialize<'a>>(text: &'a str, prefix: &str) -> Result<T, Problem> {
    // Keeping track of the path costs a third on large bodies, so it is kept only to explain a failure.
    serde_json::from_str(text).or_else(|_| {
        check(text)?;
        let mut again = serde_json::Deserializer::from_str(text);
        serde_path_to_error::deserialize(&mut again).map_err(|error| wrong(&error, prefix))
    })
}

/// Whether it is JSON at all.
fn check(text: &str) -> Result<(), Problem> {
    let malformed = |error| Problem::new(Code::MalformedJson, format!("the body is not JSON: {error}"));
    serde_json::from_str::<IgnoredAny>(text).map(drop).map_err(malformed)
}

fn wrong(error: &serde_path_to_error::Error<serde_json::Error>, prefix: &str) -> Problem {
    let mut detail = error.inner().to_string();
    // Inside a part, line and column would be those of the part.
    if !prefix.is_empty()
        && let Some(end) = detail.rfind(" at line ")
    {
        detail.truncate(end);
    }
    explain(detail, &format!("{prefix}{}", pointer(error.path())))
}

/// What is wrong, and the pointer to where.
pub(crate) fn explain(mut detail: String, pointer: &str) -> Problem {
    // What a number is to the service is of no use to its client.
    for (own, word) in
        [("f64", "a number"), ("f32", "a number"), ("u64", "a whole number"), ("usize", "a whole number")]
    {
        detail = detail.replace(&format!("expected {own}"), &format!("expected {word}"));
    }
    // serde has no error codes; these beginnings are those of its own constructors and of serde_json.
    let code = [
        ("unknown field", Code::UnknownField),
        ("duplicate field", Code::DuplicateField),
        ("missing field", Code::MissingField),
        ("number out of range", Code::NotFinite),
    ]
    .into_iter()
    .find_map(|(beginning, code)| detail.starts_with(beginning).then_some(code))
    .unwrap_or(Code::InvalidField);
    // An absent or repeated field is told with the object that has it; the name stands in the sentence.
    let field = matches!(code, Code::DuplicateField | Code::MissingField).then(|| detail.split('`').nth(1)).flatten();
    let field = field.map(|name| format!("/{name}")).unwrap_or_default();
    Problem::at(code, format!("{pointer}{field}"), detail)
}

/// JSON Pointer (RFC 6901).
fn pointer(path: &Path) -> String {
    path.iter()
        .map(|segment| match segment {
            Segment::Seq { index } => format!("/{index}"),
            Segment::Map { key } => member(key),
            Segment::Enum { .. } | Segment::Unknown => String::new(),
        })
        .collect()
}

/// That to a member.
pub(crate) fn member(name: &str) -> String {
    format!("/{}", name.replace('~', "~0").replace('/', "~1"))
}

/// A body or an element that must be a JSON object: serde would take a list of the fields as well.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Object<T>(pub(crate) T);

impl<T: Serialize> Serialize for Object<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Object<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Fields<T> {
            type Value = Object<T>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map)).map(Object)
            }
        }
        deserializer.deserialize_map(Fields(PhantomData))
    }
}

/// For `#[serde(default, deserialize_with = "present")]`: an absent field is `None`, and `null` is not a value.
pub(crate) fn present<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
    T::deserialize(deserializer).map(Some)
}

/// A list of exactly N numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Numbers<R, const N: usize>(pub(crate) [R; N]);

/// A vector: three of them.
pub(crate) type Vector<R> = Numbers<R, 3>;

/// The coefficients of drag: two.
pub(crate) type DragPair<R> = Numbers<R, 2>;

impl<'de, R: WireReal, const N: usize> Deserialize<'de> for Numbers<R, N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct List<R, const N: usize>(PhantomData<R>);
        impl<'de, R: WireReal, const N: usize> Visitor<'de> for List<R, N> {
            type Value = Numbers<R, N>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match N {
                    3 => f.write_str("a vector of three numbers"),
                    _ => write!(f, "a list of {N} numbers"),
                }
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
                let mut numbers = [R::ZERO; N];
                for (k, number) in numbers.iter_mut().enumerate() {
                    *number = list.next_element()?.ok_or_else(|| A::Error::invalid_length(k, &self))?;
                }
                if list.next_element::<IgnoredAny>()?.is_some() {
                    return Err(A::Error::invalid_length(N + 1, &self));
                }
                Ok(Numbers(numbers))
            }
        }
        deserializer.deserialize_seq(List(PhantomData))
    }
}

/// The values of a column, as they stand in a body.
pub(crate) trait Element: DeserializeOwned {
    /// What it is in the engine.
    type Value: Copy + PartialEq;
    /// Its numbers.
    type Number: Real;
    /// How many; with several, one value alone is a list, so that a list of values is a list of lists.
    const NUMBERS: usize;
    fn value(self) -> Self::Value;
    /// The value with these numbers.
    fn of(number: impl Fn(usize) -> Self::Number) -> Self::Value;
}

impl Element for f32 {
    type Value = f32;
    type Number = f32;
    const NUMBERS: usize = 1;
    fn value(self) -> f32 {
        self
    }
    fn of(number: impl Fn(usize) -> f32) -> f32 {
        number(0)
    }
}

impl Element for f64 {
    type Value = f64;
    type Number = f64;
    const NUMBERS: usize = 1;
    fn value(self) -> f64 {
        self
    }
    fn of(number: impl Fn(usize) -> f64) -> f64 {
        number(0)
    }
}

impl<R: WireReal> Element for Vector<R> {
    type Value = R::Vec3;
    type Number = R;
    const NUMBERS: usize = 3;
    fn value(self) -> R::Vec3 {
        self.0.into()
    }
    fn of(number: impl Fn(usize) -> R) -> R::Vec3 {
        [number(0), number(1), number(2)].into()
    }
}

impl<R: WireReal> Element for DragPair<R> {
    type Value = Drag<R>;
    type Number = R;
    const NUMBERS: usize = 2;
    fn value(self) -> Drag<R> {
        let Numbers([k1, k2]) = self;
        Drag { k1, k2 }
    }
    fn of(number: impl Fn(usize) -> R) -> Drag<R> {
        Drag { k1: number(0), k2: number(1) }
    }
}

impl<E: Element> Element for Option<E> {
    type Value = Option<E::Value>;
    type Number = E::Number;
    const NUMBERS: usize = E::NUMBERS;
    fn value(self) -> Option<E::Value> {
        self.map(Element::value)
    }
    fn of(number: impl Fn(usize) -> E::Number) -> Option<E::Value> {
        Some(E::of(number))
    }
}

/// A list, read straight into what it is in the engine.
struct Values<E: Element>(Vec<E::Value>);

impl<'de, E: Element> Deserialize<'de> for Values<E> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct List<E>(PhantomData<E>);
        impl<'de, E: Element> Visitor<'de> for List<E> {
            type Value = Values<E>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
                let mut values = Vec::with_capacity(list.size_hint().unwrap_or(0).min(LISTED_MAX));
                while let Some(value) = list.next_element::<E>()? {
                    values.push(value.value());
                }
                Ok(Values(values))
            }
        }
        deserializer.deserialize_seq(List(PhantomData))
    }
}

/// The most values for which there is room before they are read.
const LISTED_MAX: usize = 1 << 12;

/// A column: one value for all, or a list with one for each.
pub(crate) fn column<E: Element>(raw: Raw<'_>, field: &str) -> Result<Column<E::Value>, Problem> {
    let prefix = format!("/{field}");
    if let Some(array) = raw.typed_array() {
        return array.column::<E>().map_err(|detail| Problem::at(Code::InvalidField, prefix, detail));
    }
    let is_list = if E::NUMBERS > 1 { raw.is_list_of_lists() } else { raw.is_list() };
    if is_list {
        let Values(values) = raw.read::<Values<E>>(&prefix)?;
        Ok(Column::PerParticle(values))
    } else {
        Ok(Column::Uniform(raw.read::<E>(&prefix)?.value()))
    }
}

/// A value that is written as one of a list of names.
pub(crate) trait Choice: Copy + 'static {
    const ALL: &'static [Self];
    fn name(self) -> &'static str;
}

/// A [`Choice`] in JSON.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Named<T>(pub(crate) T);

impl<'de, T: Choice> Deserialize<'de> for Named<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Name<T>(PhantomData<T>);
        impl<T: Choice> Visitor<'_> for Name<T> {
            type Value = Named<T>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                let names: Vec<&str> = T::ALL.iter().map(|choice| choice.name()).collect();
                write!(f, "one of {}", names.join(", "))
            }
            fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<Self::Value, E> {
                let choice = T::ALL.iter().find(|choice| choice.name() == name);
                choice
                    .map(|choice| Named(*choice))
                    .ok_or_else(|| E::invalid_value(serde::de::Unexpected::Str(name), &self))
            }
        }
        deserializer.deserialize_str(Name(PhantomData))
    }
}

/// The names, for the description of the service.
pub(crate) fn choices<T: Choice>() -> Schema {
    let names: Vec<&str> = T::ALL.iter().map(|choice| choice.name()).collect();
    Schema::Object(ObjectBuilder::new().schema_type(Type::String).enum_values(Some(names)).build())
}

impl<T: Choice> Serialize for Named<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.0.name())
    }
}

#[cfg(test)]
mod tests {
    use super::{Code, DragPair, Element, Object, Problem, Raw, Vector, parse_part, text};
    use crate::column::Column;
    use crate::forces::Drag;
    use proptest::prelude::*;
    use serde::Deserialize;

    fn parse<'a, T: Deserialize<'a>>(body: &'a [u8]) -> Result<T, Problem> {
        parse_part(text(body)?, "")
    }

    fn column<E: Element>(text: &str, field: &str) -> Result<Column<E::Value>, Problem> {
        super::column::<E>(Raw::Json(text), field)
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Body {
        #[expect(dead_code, reason = "only read")]
        mass: f64,
    }

    #[test]
    fn what_is_wrong_is_told_with_its_place() {
        for (text, code, pointer) in [
            ("", Code::MalformedJson, None),
            ("{\"mass\":1", Code::MalformedJson, None),
            ("{\"mass\":1}x", Code::MalformedJson, None),
            ("{\"mass\":NaN}", Code::MalformedJson, None),
            ("{\"mass\":\"a\" ", Code::MalformedJson, None),
            ("[1]", Code::InvalidField, Some("")),
            ("{\"mass\":\"1\"}", Code::InvalidField, Some("/mass")),
            ("{\"mass\":null}", Code::InvalidField, Some("/mass")),
            ("{\"mass\":1e400}", Code::NotFinite, Some("/mass")),
            ("{\"mass\":1,\"mass\":1}", Code::DuplicateField, Some("/mass")),
            ("{\"mass\":1,\"a/b\":1}", Code::UnknownField, Some("/a~1b")),
            ("{}", Code::MissingField, Some("/mass")),
        ] {
            let problem = parse::<Object<Body>>(text.as_bytes()).expect_err(text);
            assert_eq!((problem.code, problem.pointer.as_deref()), (code, pointer), "{text}: {}", problem.detail);
        }
        let problem = parse::<Object<Body>>(b"{\"mass\":\"\xff\"}").expect_err("not UTF-8");
        assert_eq!(problem.code, Code::MalformedJson);
    }

    #[test]
    fn a_column_is_one_value_or_a_list() {
        let vector = |text| column::<Vector<f64>>(text, "position");
        assert_eq!(vector("[1,2,3]").expect("one"), Column::Uniform([1.0, 2.0, 3.0].into()));
        assert_eq!(vector(" [ [1,2,3] ]").expect("a list"), Column::PerParticle(vec![[1.0, 2.0, 3.0].into()]));
        let own = column::<Option<Vector<f64>>>("[null,[1,2,3]]", "acceleration").expect("a list with null");
        assert_eq!(own, Column::PerParticle(vec![None, Some([1.0, 2.0, 3.0].into())]));
        assert_eq!(column::<Option<Vector<f64>>>("null", "acceleration").expect("none"), Column::Uniform(None));
        for (text, pointer) in
            [("[1,2]", "/position"), ("[[1,2,3],[1,2,3,4]]", "/position/1"), ("[[1,2,\"3\"]]", "/position/0/2")]
        {
            assert_eq!(vector(text).expect_err(text).pointer.as_deref(), Some(pointer), "{text}");
        }
    }

    #[test]
    fn a_pair_is_one_value_and_not_a_list_of_two() {
        let drags = |text| column::<Option<DragPair<f64>>>(text, "drag");
        let drag = |k1, k2| Some(Drag { k1, k2 });
        assert_eq!(drags("[0.1, 0.2]").expect("one"), Column::Uniform(drag(0.1, 0.2)));
        assert_eq!(drags("null").expect("none"), Column::Uniform(None));
        assert_eq!(drags("[]").expect("a list"), Column::PerParticle(vec![]));
        let pairs = drags(" [ [1,2], null ]").expect("a list");
        assert_eq!(pairs, Column::PerParticle(vec![drag(1.0, 2.0), None]));
        assert_eq!(drags("[null,[1,2]]").expect("a list"), Column::PerParticle(vec![None, drag(1.0, 2.0)]));
        for (text, pointer) in
            [("[1]", "/drag"), ("[1,2,3]", "/drag"), ("[1,[2,3]]", "/drag/1"), ("[[1,2],3]", "/drag/1")]
        {
            assert_eq!(drags(text).expect_err(text).pointer.as_deref(), Some(pointer), "{text}");
        }
        let masses = |text| column::<Option<f64>>(text, "gravitational_mass");
        assert_eq!(masses("5").expect("one"), Column::Uniform(Some(5.0)));
        assert_eq!(masses("null").expect("none"), Column::Uniform(None));
        assert_eq!(masses("[null, 5]").expect("a list"), Column::PerParticle(vec![None, Some(5.0)]));
    }

    proptest! {
        /// Any finite bits come back, also when they are sent with more digits than needed.
        #[test]
        fn numbers_keep_their_bits(double in any::<u64>(), single in any::<u32>()) {
            let double = f64::from_bits(double);
            if double.is_finite() {
                let text = String::from_utf8(serde_json::to_vec(&double).expect("a number")).expect("ASCII");
                prop_assert_eq!(parse::<f64>(text.as_bytes()).expect(&text).to_bits(), double.to_bits());
            }
            let single = f32::from_bits(single);
            if single.is_finite() {
                let shortest = String::from_utf8(serde_json::to_vec(&single).expect("a number")).expect("ASCII");
                let exact = format!("{:e}", f64::from(single));
                for text in [shortest, exact] {
                    prop_assert_eq!(parse::<f32>(text.as_bytes()).expect(&text).to_bits(), single.to_bits());
                }
            }
        }

        /// A single is the number nearest to the digits, not to the double nearest to them.
        #[test]
        fn singles_are_rounded_once(bits in 0x0080_0000u32..0x7f00_0000) {
            let (low, high) = (f32::from_bits(bits), f32::from_bits(bits + 1));
            let middle = f64::midpoint(f64::from(low), f64::from(high));
            // A hair above the middle, by less than a double can hold.
            let text = format!("{middle:.200}").trim_end_matches('0').to_owned() + "0000000000000000000001";
            if middle > 1e-30 && middle < 1e30 {
                prop_assert_eq!(parse::<f32>(text.as_bytes()).expect(&text).to_bits(), high.to_bits(), "{}", text);
            }
        }
    }

    #[test]
    fn what_a_single_cannot_hold_is_refused() {
        for text in ["1e39", "3.4028236e38", "-1e39"] {
            assert_eq!(parse::<f32>(text.as_bytes()).expect_err(text).code, Code::NotFinite);
        }
    }
}

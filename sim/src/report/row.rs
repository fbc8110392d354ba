//! What is one row of a report? Named flat values, in the order in which they were written.
//!
//! The order is what a reader of `report.csv` and of the tables sees, so it is the struct's own order and not the
//! alphabet's (which `serde_json::Map` would give).

use std::fmt;

use serde::de::{self, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;
use thiserror::Error;

/// One row: column names and values that are numbers, strings, booleans or null, never lists or objects.
///
/// JSON knows no infinity: what is not a finite number is null here, and shown as a dash. A caller to whom infinity
/// matters caps it and says so in a note.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row(Vec<(String, Value)>);

/// Why something is not a row.
#[derive(Debug, Error)]
pub enum RowError {
    /// Not a struct or map.
    #[error("a row must be a struct or a map with text keys, not {0}")]
    NotAnObject(&'static str),
    /// A list or object within a row has no place in a CSV file.
    #[error("column `{column}` holds {kind}; a row is flat, so give it columns of its own")]
    Nested {
        /// The column.
        column: String,
        /// "a list" or "an object".
        kind: &'static str,
    },
    /// Two values under one name, for instance by a flattened field.
    #[error("column `{0}` appears twice in one row")]
    Duplicate(String),
    /// The row's own `Serialize` failed.
    #[error("a row cannot be serialised")]
    Serialise(#[from] serde_json::Error),
}

impl Row {
    /// Makes a row from a struct or map whose values are flat.
    pub fn of<T: Serialize + ?Sized>(row: &T) -> Result<Self, RowError> {
        // By way of text, which keeps the order of fields and the short decimal form of an f32.
        let text = serde_json::to_string(row)?;
        if !text.starts_with('{') {
            return Err(RowError::NotAnObject(kind(&serde_json::from_str(&text)?)));
        }
        serde_json::from_str::<Entries>(&text)?.check()
    }

    /// The row with a column before all others, which replaces one of the same name.
    pub fn with_first(mut self, key: &str, value: impl Into<Value>) -> Self {
        let value = value.into();
        debug_assert!(!matches!(value, Value::Array(_) | Value::Object(_)), "rows are flat");
        self.0.retain(|(name, _)| name != key);
        self.0.insert(0, (key.to_owned(), value));
        self
    }

    /// Columns and values in order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.0.iter().map(|(key, value)| (key.as_str(), value))
    }

    /// The value of a column, if the row has it.
    pub fn value(&self, key: &str) -> Option<&Value> {
        self.0.iter().find(|(name, _)| name == key).map(|(_, value)| value)
    }

    /// The value of a column as a number, if it is one.
    pub fn number(&self, key: &str) -> Option<f64> {
        self.value(key).and_then(Value::as_f64)
    }

    /// The value of a column for people; a dash where there is none.
    pub fn text(&self, key: &str) -> String {
        self.value(key).map_or_else(|| DASH.to_owned(), text_of)
    }
}

/// Stands for a value that is missing or not a finite number.
pub(super) const DASH: &str = "–";

/// A value for people: numbers to four digits, whole numbers in full.
pub(super) fn text_of(value: &Value) -> String {
    match value {
        Value::Null => DASH.to_owned(),
        Value::Bool(true) => "yes".to_owned(),
        Value::Bool(false) => "no".to_owned(),
        Value::Number(n) if n.is_f64() => number_text(n.as_f64().unwrap_or(f64::NAN)),
        Value::Number(n) => n.to_string(),
        Value::String(s) => printable(s),
        Value::Array(_) | Value::Object(_) => value.to_string(),
    }
}

/// A number to four significant digits, without trailing zeros; powers of ten where it is very large or small.
pub(super) fn number_text(v: f64) -> String {
    let size = v.abs();
    if !v.is_finite() {
        return DASH.to_owned();
    }
    if v == 0.0 {
        return "0".to_owned();
    }
    if !(1e-4..1e7).contains(&size) {
        let text = format!("{v:.3e}");
        let (digits, exponent) = text.split_once('e').unwrap_or((&text, "0"));
        return format!("{}e{exponent}", trim_zeros(digits));
    }
    let decimals = (3 - size.log10().floor() as i32).clamp(0, 8) as usize;
    trim_zeros(&format!("{v:.decimals$}")).to_owned()
}

fn trim_zeros(digits: &str) -> &str {
    if digits.contains('.') { digits.trim_end_matches('0').trim_end_matches('.') } else { digits }
}

/// The text with control characters replaced: neither a terminal nor a page is to be steered by a file's name.
pub(super) fn printable(text: &str) -> String {
    let steers = |c: char| c.is_control() || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    text.chars().map(|c| if steers(c) { '\u{fffd}' } else { c }).collect()
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a boolean",
        Value::Number(_) => "a number",
        Value::String(_) => "a string",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}

impl Serialize for Row {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (key, value) in &self.0 {
            map.serialize_entry(key, value)?;
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for Row {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Entries::deserialize(deserializer)?.check().map_err(de::Error::custom)
    }
}

/// A JSON object as it stands, in order, not yet known to be a row.
struct Entries(Vec<(String, Value)>);

impl Entries {
    fn check(self) -> Result<Row, RowError> {
        for (i, (column, value)) in self.0.iter().enumerate() {
            if matches!(value, Value::Array(_) | Value::Object(_)) {
                return Err(RowError::Nested { column: column.clone(), kind: kind(value) });
            }
            if self.0[..i].iter().any(|(earlier, _)| earlier == column) {
                return Err(RowError::Duplicate(column.clone()));
            }
        }
        Ok(Row(self.0))
    }
}

impl<'de> Deserialize<'de> for Entries {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct InOrder;
        impl<'de> Visitor<'de> for InOrder {
            type Value = Entries;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Entries, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(Entries(entries))
            }
        }
        deserializer.deserialize_map(InOrder)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_keeps_the_order_of_its_fields() {
        #[derive(Serialize)]
        struct Fields {
            zebra: u32,
            ape: f32,
            mule: Option<&'static str>,
        }
        let row = Row::of(&Fields { zebra: 1, ape: 0.1, mule: None }).unwrap();
        assert_eq!(serde_json::to_string(&row).unwrap(), r#"{"zebra":1,"ape":0.1,"mule":null}"#);
        assert_eq!(serde_json::from_str::<Row>(r#"{"zebra":1,"ape":0.1,"mule":null}"#).unwrap(), row);
    }

    #[test]
    fn a_nested_value_is_refused_by_name() {
        let error = Row::of(&serde_json::json!({ "policy": "visible", "delays": [1, 2] })).unwrap_err();
        assert_eq!(error.to_string(), "column `delays` holds a list; a row is flat, so give it columns of its own");
        assert!(Row::of(&serde_json::json!({ "a": { "b": 1 } })).is_err());
    }

    #[test]
    fn what_is_no_object_or_names_a_column_twice_is_refused() {
        assert!(matches!(Row::of(&[1, 2]), Err(RowError::NotAnObject("a list"))));
        assert!(matches!(Row::of(&7), Err(RowError::NotAnObject("a number"))));
        assert!(serde_json::from_str::<Row>(r#"{"a":1,"a":2}"#).unwrap_err().to_string().contains("twice"));
    }

    #[test]
    fn numbers_read_well() {
        let cases = [
            (0.0, "0"),
            (1234.56, "1235"),
            (0.1 + 0.2, "0.3"),
            (1.0 / 3.0, "0.3333"),
            (-2.5, "-2.5"),
            (1.5e-9, "1.5e-9"),
            (123_456_789.0, "1.235e8"),
            (f64::NAN, DASH),
            (f64::INFINITY, DASH),
        ];
        for (number, text) in cases {
            assert_eq!(number_text(number), text);
        }
        assert_eq!(text_of(&serde_json::json!(18_446_744_073_709_551_615_u64)), "18446744073709551615");
    }

    #[test]
    fn control_characters_do_not_reach_a_terminal() {
        assert_eq!(printable("a\u{1b}[2Jb\n\u{202e}"), "a\u{fffd}[2Jb\u{fffd}\u{fffd}");
    }
}

//! Parameters and their scopes: the value of an attribute, `$name` or `${expression}`, is found
//! when it is read.
//!
//! A parameter holds within the element that has its `<ParameterDeclarations>`; the innermost
//! declaration counts. What a reference to a catalog assigns replaces the defaults of the entry.

use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::HashMap;

use decouplegs_asset::DecodeError;
use decouplegs_asset::xml::{self, Element, excerpt};

use super::expression;

/// Longest value of a parameter, bytes.
const VALUE_BYTES_MAX: usize = 1000;
/// Longest chain of parameters whose values name other parameters.
const CHAIN_MAX: usize = 32;

/// Values of parameters by name, as a reference assigns them.
pub(super) type Assignments = HashMap<String, String>;

/// Declarations of a document.
pub(super) struct Parameters<'a> {
    /// Declarations by the element in which they hold and by name.
    declared: HashMap<(u32, &'a str), Element<'a>>,
    /// Values that replace all declarations of their name.
    assigned: Assignments,
    /// Values found before, by declaration: each is evaluated once, however often it is used.
    found: RefCell<HashMap<u32, String>>,
}

impl<'a> Parameters<'a> {
    /// The declarations below `root`. `assigned` replace their values.
    pub(super) fn new(root: Element<'a>, assigned: Assignments) -> Self {
        let mut declared = HashMap::new();
        for list in root.descendants("ParameterDeclarations") {
            let Some(scope) = list.parent() else { continue };
            for declaration in list.all("ParameterDeclaration") {
                if let Some(name) = declaration.attribute("name") {
                    let name = name.trim_start_matches('$');
                    declared.entry((scope.key(), name)).or_insert(declaration);
                }
            }
        }
        Self {
            declared,
            assigned,
            found: RefCell::default(),
        }
    }

    /// `text` of an attribute of `element`, its parameter or expression replaced by the value.
    fn value(&self, element: Element, text: &'a str) -> Result<Cow<'a, str>, String> {
        if !text.starts_with('$') {
            // A backslash keeps a text that begins with a dollar sign as it is.
            let literal = text.strip_prefix('\\').filter(|text| text.starts_with('$'));
            return Ok(Cow::Borrowed(literal.unwrap_or(text)));
        }
        self.evaluated(element, text, 0).map(Cow::Owned)
    }

    /// The value of `text`, which a chain of `depth` parameters led to.
    fn evaluated(&self, element: Element, text: &str, depth: usize) -> Result<String, String> {
        let Some(rest) = text.strip_prefix('$') else {
            return Ok(text.to_owned());
        };
        let mut parameter = |name: &str| self.parameter(element, name, depth);
        if let Some(expression) = rest.strip_prefix('{') {
            let inner = expression
                .strip_suffix('}')
                .ok_or_else(|| format!("the expression {} does not end with }}", excerpt(text)))?;
            return expression::evaluate(inner, &mut parameter)
                .map_err(|reason| format!("the expression {}: {reason}", excerpt(text)));
        }
        let is_name =
            rest.starts_with(|letter: char| letter.is_ascii_alphabetic() || letter == '_');
        if is_name {
            parameter(rest)
        } else {
            Ok(text.to_owned())
        }
    }

    /// Value of the parameter that `name` means in `element`.
    fn parameter(&self, element: Element, name: &str, depth: usize) -> Result<String, String> {
        if let Some(assigned) = self.assigned.get(name) {
            return Ok(assigned.clone());
        }
        let mut scope = Some(element);
        let declaration = loop {
            let Some(within) = scope else {
                return Err(format!("the parameter ${} is not declared", excerpt(name)));
            };
            if let Some(declaration) = self.declared.get(&(within.key(), name)) {
                break *declaration;
            }
            scope = within.parent();
        };
        if let Some(found) = self.found.borrow().get(&declaration.key()) {
            return Ok(found.clone());
        }
        if depth == CHAIN_MAX {
            return Err(format!(
                "the parameter ${} names others in a circle, or in a chain of more than {CHAIN_MAX}",
                excerpt(name)
            ));
        }
        let text = declaration.attribute("value").unwrap_or_default();
        if text.len() > VALUE_BYTES_MAX {
            return Err(format!(
                "the value of ${} has {} bytes; at most {VALUE_BYTES_MAX} are read",
                excerpt(name),
                text.len()
            ));
        }
        let value = self.evaluated(declaration, text, depth + 1)?;
        self.found
            .borrow_mut()
            .insert(declaration.key(), value.clone());
        Ok(value)
    }
}

/// An element whose attributes are evaluated when they are read.
#[derive(Clone, Copy)]
pub(super) struct Node<'a> {
    element: Element<'a>,
    parameters: &'a Parameters<'a>,
}

impl<'a> Node<'a> {
    pub(super) fn new(element: Element<'a>, parameters: &'a Parameters<'a>) -> Self {
        Self {
            element,
            parameters,
        }
    }

    /// The element itself.
    pub(super) fn element(self) -> Element<'a> {
        self.element
    }

    fn with(self, element: Element<'a>) -> Self {
        Self { element, ..self }
    }

    pub(super) fn name(self) -> &'a str {
        self.element.name()
    }

    pub(super) fn line(self) -> u32 {
        self.element.line()
    }

    pub(super) fn elements(self) -> impl Iterator<Item = Self> {
        self.element
            .elements()
            .map(move |element| self.with(element))
    }

    pub(super) fn all(self, name: &str) -> impl Iterator<Item = Self> {
        self.element
            .all(name)
            .map(move |element| self.with(element))
    }

    pub(super) fn first(self, name: &str) -> Option<Self> {
        self.element.first(name).map(|element| self.with(element))
    }

    pub(super) fn needed(self, name: &str) -> Result<Self, DecodeError> {
        Ok(self.with(self.element.needed(name)?))
    }

    /// Value of an attribute.
    pub(super) fn attribute(self, name: &str) -> Result<Option<Cow<'a, str>>, DecodeError> {
        let Some(text) = self.element.attribute(name) else {
            return Ok(None);
        };
        match self.parameters.value(self.element, text) {
            Ok(value) => Ok(Some(value)),
            Err(reason) => Err(self.fault(format!("{name}: {reason}"))),
        }
    }

    pub(super) fn needed_attribute(self, name: &str) -> Result<Cow<'a, str>, DecodeError> {
        match self.attribute(name)? {
            Some(value) => Ok(value),
            None => self.element.needed_attribute(name).map(Cow::Borrowed),
        }
    }

    /// True if an attribute has `value`; false also where it has no value.
    pub(super) fn is(self, name: &str, value: &str) -> Result<bool, DecodeError> {
        Ok(self.attribute(name)?.is_some_and(|found| found == value))
    }

    /// A truth in an attribute, false if it is absent.
    pub(super) fn truth(self, name: &str) -> Result<bool, DecodeError> {
        Ok(self.is(name, "true")? || self.is(name, "1")?)
    }

    pub(super) fn number(self, name: &str) -> Result<f64, DecodeError> {
        let text = self.needed_attribute(name)?;
        xml::finite(&text)
            .ok_or_else(|| self.fault(format!("{name}=\"{}\" is no finite number", excerpt(&text))))
    }

    pub(super) fn number_or(self, name: &str, otherwise: f64) -> Result<f64, DecodeError> {
        if self.element.attribute(name).is_some() {
            self.number(name)
        } else {
            Ok(otherwise)
        }
    }

    /// Value of the parameter that `name`, with or without its dollar sign, means here.
    pub(super) fn parameter(self, name: &str) -> Result<String, DecodeError> {
        let name = name.trim_start_matches('$');
        self.parameters
            .parameter(self.element, name, 0)
            .map_err(|reason| self.fault(reason))
    }

    pub(super) fn fault(self, reason: impl AsRef<str>) -> DecodeError {
        self.element.fault(reason)
    }

    /// Values that its `<ParameterAssignments>` give, evaluated where it stands.
    pub(super) fn assignments(self) -> Result<Assignments, DecodeError> {
        let lists = self.all("ParameterAssignments");
        lists
            .flat_map(|list| list.all("ParameterAssignment"))
            .map(|assignment| {
                // A reference, not a value: the name, which many files write with its dollar sign.
                let name = assignment.element.needed_attribute("parameterRef")?;
                let value = assignment.needed_attribute("value")?;
                if value.len() > VALUE_BYTES_MAX {
                    return Err(assignment.fault(format!(
                        "a value of {} bytes; at most {VALUE_BYTES_MAX} are read",
                        value.len()
                    )));
                }
                Ok((name.trim_start_matches('$').to_owned(), value.into_owned()))
            })
            .collect()
    }
}

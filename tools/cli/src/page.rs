//! Pages of reports: HTML files that need nothing beside them.

use std::fmt::{Display, Write};

use anyhow::Result;
use base64::{Engine, engine::general_purpose::STANDARD};
use decouplegs_render::rendered_image::{Image, ImageFileFormat};

/// Style sheet of charts: readable on a light and on a dark background.
const CHART_STYLE: &str = include_str!("page/charts.css");
/// Style sheet of the rest of the page, in the same colors.
const STYLE: &str = include_str!("page/page.css");

/// `text` as HTML shows it.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// A page, from its heading down. It follows the reader's choice of light or dark.
pub struct Page {
    html: String,
}

impl Page {
    /// A page with nothing but its title.
    pub fn new(title: &str) -> Self {
        let title = escaped(title);
        let html = format!(
            "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
             <title>{title}</title><style>{CHART_STYLE}{STYLE}</style><h1>{title}</h1>"
        );
        Self { html }
    }

    /// Appends HTML.
    pub fn html(&mut self, html: &str) {
        self.html.push_str(html);
    }

    /// Begins a part.
    pub fn heading(&mut self, title: &str) {
        self.element("h2", &escaped(title));
    }

    /// Begins a part of a part.
    pub fn subheading(&mut self, title: &str) {
        self.element("h3", &escaped(title));
    }

    /// Appends a paragraph of text.
    pub fn text(&mut self, text: &str) {
        self.element("p", &escaped(text));
    }

    /// Appends a paragraph of text in a paler color: conditions, and how to read a table.
    pub fn note(&mut self, text: &str) {
        let _ = write!(self.html, "<p class=\"dim\">{}</p>", escaped(text));
    }

    /// Appends a list; its items are HTML.
    pub fn list(&mut self, items: impl IntoIterator<Item = impl Display>) {
        self.html.push_str("<ul>");
        items
            .into_iter()
            .for_each(|item| self.element("li", &item.to_string()));
        self.html.push_str("</ul>");
    }

    /// Appends a table.
    pub fn table(&mut self, table: &Table) {
        self.html.push_str(&table.to_html());
    }

    /// Appends figures side by side, as many as there is room for.
    pub fn row(&mut self, figures: impl IntoIterator<Item = Figure>) {
        self.figures("row", figures);
    }

    /// Appends figures in one row, which is scrolled where it is wider than the page.
    pub fn strip(&mut self, figures: impl IntoIterator<Item = Figure>) {
        self.figures("wide strip", figures);
    }

    /// The whole page.
    pub fn finish(mut self) -> String {
        self.html.push_str("</html>\n");
        self.html
    }

    fn figures(&mut self, class: &str, figures: impl IntoIterator<Item = Figure>) {
        let figures: String = figures.into_iter().map(|figure| figure.0).collect();
        if !figures.is_empty() {
            let _ = write!(self.html, "<div class=\"{class}\">{figures}</div>");
        }
    }

    fn element(&mut self, tag: &str, html: &str) {
        let _ = write!(self.html, "<{tag}>{html}</{tag}>");
    }
}

/// A drawing or an image with its caption.
pub struct Figure(String);

impl Figure {
    /// A drawing in its own size.
    pub fn svg(svg: &str) -> Self {
        Self(format!("<figure>{svg}</figure>"))
    }

    /// A drawing that shares the width of the page with others.
    pub fn flexible_svg(svg: &str) -> Self {
        Self(format!("<figure class=\"flexible\">{svg}</figure>"))
    }

    /// An image above its caption, pixel by pixel.
    ///
    /// # Errors
    /// Returns an error if the image cannot be encoded.
    pub fn image(caption: &str, image: &Image) -> Result<Self> {
        let (caption, address) = (escaped(caption), png_address(image)?);
        Ok(Self(format!(
            "<figure><img class=\"pixels\" src=\"{address}\" alt=\"{caption}\"><figcaption>{caption}</figcaption></figure>"
        )))
    }
}

/// `image` as a PNG in a `data:` address.
fn png_address(image: &Image) -> Result<String> {
    let bytes = image.encode(ImageFileFormat::Png)?;
    Ok(format!("data:image/png;base64,{}", STANDARD.encode(bytes)))
}

/// A table: numbers to the right, names in the first column.
pub struct Table {
    columns: Vec<(String, Alignment)>,
    /// All rows as HTML.
    rows: String,
}

#[derive(Clone, Copy, PartialEq)]
enum Alignment {
    /// Numbers, on one line.
    Right,
    /// Sentences, which are broken into lines.
    Text,
}

impl Table {
    /// An empty table with these columns.
    pub fn new(columns: impl IntoIterator<Item = impl Display>) -> Self {
        let columns = columns.into_iter();
        Self {
            columns: columns
                .map(|name| (escaped(&name.to_string()), Alignment::Right))
                .collect(),
            rows: String::new(),
        }
    }

    /// Sets sentences in a column to the left.
    pub fn with_text_in(mut self, column: usize) -> Self {
        self.columns[column].1 = Alignment::Text;
        self
    }

    /// Appends a row of text. A last cell before the last column spans the columns that remain, as
    /// a sentence.
    pub fn row(&mut self, cells: impl IntoIterator<Item = impl Display>) {
        self.row_that_stands_out(false, cells);
    }

    /// Appends a row of text that stands out where `is_main` says so.
    pub fn row_that_stands_out(
        &mut self,
        is_main: bool,
        cells: impl IntoIterator<Item = impl Display>,
    ) {
        self.row_of_html(
            is_main,
            cells.into_iter().map(|cell| escaped(&cell.to_string())),
        );
    }

    /// Appends a row whose cells are HTML.
    pub fn row_of_html(&mut self, is_main: bool, cells: impl IntoIterator<Item = String>) {
        let cells: Vec<String> = cells.into_iter().collect();
        let missing = self.columns.len().saturating_sub(cells.len());
        self.rows.push_str(if is_main {
            "<tr class=\"main\">"
        } else {
            "<tr>"
        });
        for (at, cell) in cells.iter().enumerate() {
            let is_text = self.columns[at].1 == Alignment::Text;
            let spans = missing > 0 && at + 1 == cells.len();
            let _ = match (spans, is_text) {
                (true, _) => write!(
                    self.rows,
                    "<td colspan=\"{}\" class=\"text\">{cell}",
                    missing + 1
                ),
                (false, true) => write!(self.rows, "<td class=\"text\">{cell}"),
                (false, false) => write!(self.rows, "<td>{cell}"),
            };
        }
        self.rows.push_str("</tr>");
    }

    fn to_html(&self) -> String {
        let head = self
            .columns
            .iter()
            .map(|(name, alignment)| match alignment {
                Alignment::Right => format!("<th>{name}"),
                Alignment::Text => format!("<th class=\"text\">{name}"),
            });
        format!(
            "<div class=\"wide\"><table><tr>{}</tr>{}</table></div>",
            head.collect::<String>(),
            self.rows
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_escaped_and_html_is_not() {
        let mut page = Page::new("a < b");
        page.heading("\"c\" & d");
        page.list(["<b>e</b>"]);
        let html = page.finish();
        assert!(html.contains("<title>a &lt; b</title>") && html.ends_with("</ul></html>\n"));
        assert!(html.contains("<h2>&quot;c&quot; &amp; d</h2><ul><li><b>e</b></li></ul>"));
    }

    #[test]
    fn a_short_row_ends_in_a_sentence() {
        let mut table = Table::new(["mode", "agents", "ms", "what"])
            .with_text_in(0)
            .with_text_in(3);
        table.row(["a<b", "1", "2.0", "whole"]);
        table.row_that_stands_out(true, ["c", "not drawn"]);
        let html = table.to_html();
        assert!(
            html.contains("<th>ms<th class=\"text\">what</tr>"),
            "{html}"
        );
        assert!(
            html.contains("<tr><td class=\"text\">a&lt;b<td>1<td>2.0<td class=\"text\">whole</tr>"),
            "{html}"
        );
        assert!(
            html.contains(
                "<tr class=\"main\"><td class=\"text\">c<td colspan=\"3\" class=\"text\">not drawn</tr>"
            ),
            "{html}"
        );
    }

    #[test]
    fn images_are_part_of_the_page() {
        let image = Image::filled(3, 2, [0.5; 3]);
        let address = png_address(&image).unwrap();
        let bytes = STANDARD
            .decode(address.strip_prefix("data:image/png;base64,").unwrap())
            .unwrap();
        assert_eq!(bytes, image.encode(ImageFileFormat::Png).unwrap());
        let figure = Figure::image("3 < 4", &image).unwrap().0;
        assert!(
            figure.contains("<figcaption>3 &lt; 4</figcaption>"),
            "{figure}"
        );
    }
}

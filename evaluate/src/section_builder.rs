//! Builds an experiment's section of the report: claims, tables and figures of its results, under its name.

use super::Quantity;
use super::plot::dots::{self, Dots};
use super::plot::polar::{self, Polar, Scales};
use super::results::Results;
use super::section_content::{Claim, Figure, Row, SectionContent, Table};
use super::statistics::{Expected, PerSeed, Spread};

/// Conditions that are averaged, such as all directions at one command, by their indices.
pub struct ConditionGroup {
    pub name: String,
    pub conditions: Vec<usize>,
}

impl ConditionGroup {
    pub fn new(name: impl Into<String>, conditions: impl IntoIterator<Item = usize>) -> Self {
        ConditionGroup { name: name.into(), conditions: conditions.into_iter().collect() }
    }
}

/// The section of an experiment under construction.
pub struct SectionBuilder<'a> {
    name: &'static str,
    pub results: &'a Results,
    pub content: SectionContent,
}

impl<'a> SectionBuilder<'a> {
    pub fn new(name: &'static str, results: &'a Results) -> Self {
        SectionBuilder { name, results, content: SectionContent::default() }
    }

    /// Returns the experiment's name, or `NAME-part` if the part is not empty.
    fn named(&self, part: &str) -> String {
        if part.is_empty() { self.name.to_owned() } else { format!("{}-{part}", self.name) }
    }

    /// Returns the indices of all conditions.
    pub fn all(&self) -> Vec<usize> {
        (0..self.results.conditions.len()).collect()
    }

    /// Splits all conditions, in their order, into groups of equal size, one for each value and with its name.
    pub fn groups(&self, values: &[f64], name: impl Fn(f64) -> String) -> Vec<ConditionGroup> {
        let size = self.results.conditions.len() / values.len().max(1);
        let group = |(k, value): (usize, &f64)| ConditionGroup::new(name(*value), k * size..(k + 1) * size);
        values.iter().enumerate().map(group).collect()
    }

    /// Returns each condition as a group.
    pub fn each(&self) -> Vec<ConditionGroup> {
        let conditions = self.results.conditions.iter().enumerate();
        conditions.map(|(index, condition)| ConditionGroup::new(&condition.label, [index])).collect()
    }

    /// Returns the label of the first condition.
    pub fn first_label(&self) -> &'a str {
        self.results.conditions.first().map_or("", |condition| &condition.label)
    }

    /// Adds the claim that the first set's mean of a quantity over some conditions is higher or lower than the second's.
    pub fn claim(&mut self, text: &str, paper: &str, quantity: &str, expected: Expected, over: &[usize]) {
        let comparison = self.results.compare_over(over, quantity);
        let claim = Claim::new(text, paper, self.results.quantity(quantity), expected, comparison);
        self.content.claims.push(claim);
    }

    /// Adds a table of all quantities in all conditions to the page.
    pub fn table(&mut self, caption: &str) -> &mut Table {
        self.add_table("", caption, self.rows(&self.each()), true)
    }

    /// Adds a table of all quantities in all conditions, as a file only.
    pub fn table_in_file(&mut self, part: &str, caption: &str) {
        self.add_table(part, caption, self.rows(&self.each()), false);
    }

    /// Adds a table of these rows to the page.
    pub fn table_with_rows(&mut self, caption: &str, rows: Vec<Row>) {
        self.add_table("", caption, rows, true);
    }

    /// Adds a table of these rows, to the page too if it is `in_page`.
    pub fn add_table(&mut self, part: &str, caption: &str, rows: Vec<Row>, in_page: bool) -> &mut Table {
        let index = self.content.tables.len();
        self.content.tables.push(Table::new(self.named(part), caption, rows, in_page));
        &mut self.content.tables[index]
    }

    /// Returns a row for each group and quantity: the mean over the group.
    pub fn rows(&self, groups: &[ConditionGroup]) -> Vec<Row> {
        let quantities = self.results.quantities;
        groups.iter().flat_map(|group| quantities.iter().map(|quantity| self.row(group, *quantity))).collect()
    }

    /// Returns the row of a quantity's mean over a group.
    pub fn row(&self, group: &ConditionGroup, quantity: Quantity) -> Row {
        Row::new(&group.name, quantity, self.results.compare_over(&group.conditions, quantity.name))
    }

    pub fn figure(&mut self, part: &str, caption: impl Into<String>, svg: String) {
        self.content.figures.push(Figure { name: self.named(part), caption: caption.into(), svg });
    }

    /// Adds a figure of quantities by condition, with a panel for each quantity.
    pub fn dots(&mut self, part: &str, title: &str, quantities: &[&str], more: &str) {
        self.grouped_dots(part, title, &self.each(), quantities, more);
    }

    /// Adds a figure of quantities by group of conditions, with a panel for each of their names in `values`.
    pub fn grouped_dots(&mut self, part: &str, title: &str, groups: &[ConditionGroup], values: &[&str], more: &str) {
        let panel = |name: &&str| {
            let row =
                |group: &ConditionGroup| self.by_set(|set| self.results.per_seed_over(set, &group.conditions, name));
            Dots { quantity: self.results.quantity(name), rows: groups.iter().map(row).collect() }
        };
        let panels: Vec<Dots> = values.iter().map(panel).collect();
        let labels: Vec<String> = groups.iter().map(|group| group.name.clone()).collect();
        self.panels(part, title, &panels, &labels, more);
    }

    /// Adds a figure of panels. Its caption is the title, `more`, and the meaning of the marks.
    pub fn panels(&mut self, part: &str, title: &str, panels: &[Dots], labels: &[String], more: &str) {
        let marks = match self.has_several_seeds() {
            true if panels.iter().any(|panel| panel.quantity.unit == "%") => {
                "Mean ± standard deviation over seeds, cut off at 0 and 100 %; single seeds as hollow marks."
            }
            true => "Mean ± standard deviation over seeds; single seeds as hollow marks.",
            false => "Each mark is the mean over the trials of one policy.",
        };
        let svg = dots::draw(title, panels, labels, &self.results.names);
        self.figure(part, format!("{title}. {more} {marks}").replace("  ", " "), svg);
    }

    /// Adds a figure of a quantity by direction, with a panel for each group. The conditions of a group are in the order of the
    /// `directions`, which divide the circle evenly, once or several times. The caption is the title and `more`.
    pub fn polar(
        &mut self,
        part: &str,
        title: &str,
        (quantity, axis): (&str, &str),
        (groups, directions): (&[ConditionGroup], u32),
        scales: Scales,
        more: &str,
    ) {
        let (directions, scale) = (directions as usize, self.results.quantity(quantity).scale());
        let spread = |set, group: &ConditionGroup, direction| {
            let at: Vec<usize> = group.conditions.iter().copied().skip(direction).step_by(directions).collect();
            Spread::from_values(&self.results.per_seed_over(set, &at, quantity)).map(|spread| spread.times(scale))
        };
        let panel = |group: &ConditionGroup| Polar {
            title: group.name.clone(),
            sets: self.by_set(|set| (0..directions).map(|direction| spread(set, group, direction)).collect()),
        };
        let panels: Vec<Polar> = groups.iter().map(panel).collect();
        let svg = polar::draw(title, &panels, &self.results.names, axis, scales);
        let spread = if self.has_several_seeds() { ": mean ± standard deviation over seeds" } else { "" };
        self.figure(part, format!("{title}{spread}. {more}"), svg);
    }

    fn has_several_seeds(&self) -> bool {
        self.results.sets.iter().any(|set| set.len() > 1)
    }

    /// Returns the value of a function for each set.
    pub fn by_set<T>(&self, of: impl Fn(usize) -> T) -> Vec<T> {
        (0..self.results.sets.len()).map(of).collect()
    }

    /// Returns the means of a quantity in a condition, by set and seed.
    pub fn per_seed(&self, condition: usize, quantity: &str) -> Vec<PerSeed> {
        self.by_set(|set| self.results.per_seed(set, condition, quantity))
    }
}

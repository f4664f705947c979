//! Prints drives that were found on links and ports, or that a server has.

use polepair::axis::{DeviceDetail, summarize_details};
use polepair::scan::DetectedDrive;
use polepair::url::AxisNumber;
use polepair_capture::jsonl;
use polepair_client::message::{AxisInfo, FoundDrive};

use crate::data_output::DataOutput;
use crate::problem::Result;
use crate::target::OutputFormat;
use crate::terminal::{TextTable, colour_out, csv_line};

/// A column of drives.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum DriveColumn {
    /// Connection string of the drive, to be pasted.
    Url,
    /// Address of the drive.
    Axis,
    /// The link of a server that it is on.
    Link,
    /// Name in a rack file.
    Name,
    /// The profile's word.
    Drive,
    /// Source of the identification.
    Known,
    /// The product's full name.
    Product,
    /// Conflict with another device.
    Clash,
    /// Device information.
    Reported,
}

use DriveColumn::{Axis, Clash, Drive, Known, Link, Name, Product, Reported, Url};

impl DriveColumn {
    const fn word(self) -> &'static str {
        match self {
            Url => "url",
            Axis => "axis",
            Link => "link",
            Name => "name",
            Drive => "drive",
            Known => "known",
            Product => "product",
            Clash => "clash",
            Reported => "reported",
        }
    }

    /// Head of the column in a table for people.
    const fn head(self) -> &'static str {
        match self {
            Url => "connection string",
            Known => "known by",
            other => other.word(),
        }
    }
}

/// A drive, as far as its source knows it.
#[derive(Default)]
pub struct DriveRow {
    pub url: String,
    pub number: u32,
    pub link: u16,
    pub name: String,
    pub profile: String,
    pub product: String,
    pub known: String,
    pub clash: Option<String>,
    pub reported: String,
    /// Device information item by item; `None` from a server, which sends it in one line.
    pub details: Option<Vec<DeviceDetail>>,
    /// True if the drive replies to every address.
    pub ignores_address: bool,
}

impl From<&DetectedDrive> for DriveRow {
    fn from(found: &DetectedDrive) -> Self {
        Self {
            number: found.number,
            profile: found.profile.name.to_owned(),
            product: found.profile.title.to_owned(),
            known: found.identified.to_string(),
            clash: found.clash.clone(),
            reported: summarize_details(&found.details),
            details: Some(found.details.clone()),
            ignores_address: found.ignores_address,
            ..Self::default()
        }
    }
}

impl DriveRow {
    /// A drive that a server found on one of its links.
    pub fn found_by_server(link: u16, found: &FoundDrive) -> Self {
        Self {
            number: found.number,
            link,
            profile: found.profile.clone(),
            product: found.drive.clone(),
            known: found.known.clone(),
            clash: found.clash.clone(),
            reported: found.reported.clone(),
            ..Self::default()
        }
    }

    /// An axis of a server.
    pub fn of_server(axis: &AxisInfo) -> Self {
        Self {
            number: axis.number,
            link: axis.link,
            name: axis.name.clone(),
            profile: axis.profile.clone(),
            product: axis.drive.clone(),
            ..Self::default()
        }
    }

    fn cell(&self, column: DriveColumn) -> String {
        match column {
            Url => self.url.clone(),
            Axis => AxisNumber(self.number).to_string(),
            Link => self.link.to_string(),
            Name => self.name.clone(),
            Drive => self.profile.clone(),
            Known => self.known.clone(),
            Product => self.product.clone(),
            Clash => self.clash.clone().unwrap_or_default(),
            Reported => self.reported.clone(),
        }
    }

    fn write_json(&self, columns: &[DriveColumn], out: &mut Vec<u8>) {
        for (at, column) in columns.iter().enumerate() {
            out.extend_from_slice(if at == 0 { b"{" } else { b"," });
            jsonl::write_string(out, column.word());
            out.push(b':');
            match column {
                Axis => {
                    out.extend_from_slice(AxisNumber(self.number).json().to_string().as_bytes())
                }
                Link => out.extend_from_slice(self.link.to_string().as_bytes()),
                Clash => out.extend_from_slice(self.clash.is_some().to_string().as_bytes()),
                _ => jsonl::write_string(out, &self.cell(*column)),
            }
        }
        if let Some(details) = &self.details {
            let ignores = self.ignores_address;
            let key = format!(",\"ignores_address\":{ignores},\"details\":{{");
            out.extend_from_slice(key.as_bytes());
            for (at, detail) in details.iter().enumerate() {
                out.extend_from_slice(if at == 0 { b"" } else { b"," });
                jsonl::write_string(out, &detail.name);
                out.push(b':');
                jsonl::write_string(out, &detail.text);
            }
            out.push(b'}');
        }
        out.extend_from_slice(b"}\n");
    }
}

/// Prints drives, a row each. `columns` are those for programs; a table for people leaves out the conflicts, which are
/// lines below it.
pub fn print_drives(
    drives: &[DriveRow],
    columns: &[DriveColumn],
    format: OutputFormat,
) -> Result<()> {
    let mut out = DataOutput::stdout().with_text(format == OutputFormat::Text);
    match format {
        OutputFormat::Text if drives.is_empty() => {}
        OutputFormat::Text => {
            let is_found = columns.contains(&Clash);
            let shown: Vec<DriveColumn> =
                columns.iter().copied().filter(|column| *column != Clash).collect();
            let heads: Vec<&str> = shown.iter().map(|column| column.head()).collect();
            let mut table = TextTable::with_heads(&heads);
            for drive in drives {
                table.add_row(shown.iter().map(|column| drive.cell(*column)));
            }
            out.buffer().extend_from_slice(table.render(colour_out()).as_bytes());
            for drive in drives.iter().filter(|_| is_found) {
                let number = AxisNumber(drive.number);
                let link = if columns.contains(&Link) {
                    format!(" of link {}", drive.link)
                } else {
                    String::new()
                };
                if let Some(clash) = &drive.clash {
                    out.write_line(&format!("axis {number}{link}: {clash}"));
                }
                if drive.ignores_address {
                    out.write_line(&format!("axis {number}{link}: replies to every address"));
                }
            }
        }
        OutputFormat::Jsonl => {
            drives.iter().for_each(|drive| drive.write_json(columns, out.buffer()))
        }
        OutputFormat::Csv => {
            let words: Vec<&str> = columns.iter().map(|column| column.word()).collect();
            out.write_line(&words.join(","));
            for drive in drives {
                let cells: Vec<String> = columns.iter().map(|column| drive.cell(*column)).collect();
                out.write_line(&csv_line(cells.iter().map(String::as_str)));
            }
        }
    }
    out.flush()
}

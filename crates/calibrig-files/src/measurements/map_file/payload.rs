//! Loads on the flange in a column map.

use super::Reader;
use super::entries::RawEntry;
use super::tables::ColumnsTable;
use crate::input::{InputError, Spanned};
use crate::measurements::columns::PayloadColumns;
use crate::measurements::units::LengthUnit;
use crate::payloads::{PayloadFile, PayloadTable, read_payloads};

impl Reader<'_> {
    pub fn payload(
        &self,
        t: &ColumnsTable,
        tables: &[Spanned<PayloadTable>],
    ) -> Result<Option<PayloadColumns>, InputError> {
        let known = read_payloads(self.source, tables, PayloadFile::ColumnMap)?;
        let centre = [&t.payload_x_mm, &t.payload_y_mm, &t.payload_z_mm];
        let force = [&t.payload_force_x_n, &t.payload_force_y_n, &t.payload_force_z_n];
        let numbers = [&t.payload_mass_kg].into_iter().chain(centre).chain(force);
        let number = numbers.flatten().next();
        match (&t.payload, number, tables.first()) {
            (None, None, None) => Ok(None),
            (_, Some(number), Some(_)) => {
                let message = "payloads are given twice: by columns of numbers, and by [[payload]]";
                Err(self.error(
                    number.span(),
                    message,
                    "either payload with [[payload]], or payload_mass_kg and its centre",
                ))
            }
            (None, None, Some(table)) => {
                let message = "no column says which rows carry this payload";
                Err(self.error(
                    table.span(),
                    message,
                    "payload in [columns]: the column with the payloads' names; a payload that all rows carry belongs in a \
                     session file (--session)",
                ))
            }
            (Some(column), None, Some(_)) => {
                Ok(Some(PayloadColumns::Named { column: self.single(column)?, known }))
            }
            (Some(column), None, None) => {
                let message = "payload names a column, but the names in it are not described";
                Err(self.error(column.span(), message, "[[payload]] with name, mass_kg, x_mm, y_mm and z_mm"))
            }
            (name, Some(number), None) => {
                let span = number.span();
                let column = |key: &str, entry: &Option<Spanned<RawEntry>>| {
                    self.sum(self.needed(("columns", &span), key, entry.as_ref())?)
                };
                let three = |keys: [&str; 3], [x, y, z]: [&Option<Spanned<RawEntry>>; 3]| {
                    Ok::<_, InputError>([column(keys[0], x)?, column(keys[1], y)?, column(keys[2], z)?])
                };
                let has_force = force.iter().any(|entry| entry.is_some());
                let forces = ["payload_force_x_n", "payload_force_y_n", "payload_force_z_n"];
                Ok(Some(PayloadColumns::Numbers {
                    name: name.as_ref().map(|name| self.single(name)).transpose()?,
                    mass: column("payload_mass_kg", &t.payload_mass_kg)?,
                    centre: three(["payload_x_mm", "payload_y_mm", "payload_z_mm"], centre)?,
                    unit: LengthUnit::Mm,
                    force: if has_force { Some(three(forces, force)?) } else { None },
                }))
            }
        }
    }
}

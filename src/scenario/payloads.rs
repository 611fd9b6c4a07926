//! `[[payload]]` and `[carried]`: loads for the flange, and which poses carry them.

use serde::Deserialize;

use calibrig_files::{
    InputError, PayloadFile, PayloadTable, Source, Spanned, payload_by_name, read_payloads,
};
use calibrig_model::Payload;
use calibrig_plant::session::{PayloadOrder, PayloadPlan, PlannedPayload};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CarriedFile {
    identification: Option<Spanned<Vec<Spanned<String>>>>,
    verification: Option<Spanned<Vec<Spanned<String>>>>,
    order: Option<OrderFile>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum OrderFile {
    Blocks,
    Cycle,
}

/// The loads of a session with sets of so many poses.
pub(super) fn payloads(
    source: &Source,
    tables: &[Spanned<PayloadTable>],
    carried: Option<&Spanned<CarriedFile>>,
    poses: [u32; 2],
) -> Result<PayloadPlan, InputError> {
    let stated = read_payloads(source, tables, PayloadFile::Scenario)?;
    let Some(section) = carried else {
        return match tables.first() {
            None => Ok(PayloadPlan::default()),
            Some(table) => {
                let help = "expected [carried] with identification = [\"none\", ...] or verification, which state which poses \
                            carry it".to_owned();
                Err(source.error(table.span(), "no pose carries this payload", Some(help)))
            }
        };
    };
    let file = section.get_ref();
    let lists =
        [("identification", &file.identification, poses[0]), ("verification", &file.verification, poses[1])];
    let mut carried: [Vec<Option<usize>>; 2] = Default::default();
    for ((key, list, poses), carried) in lists.into_iter().zip(&mut carried) {
        let Some(list) = list else { continue };
        for name in list.get_ref() {
            let names = stated.iter().map(|payload| payload.name.as_str());
            let index = payload_by_name(name.get_ref(), names).map_err(|expected| {
                let message = format!("carried.{key} names {:?}", name.get_ref());
                source.error(name.span(), message, Some(format!("expected {expected}")))
            })?;
            carried.push(index);
        }
        if carried.is_empty() || carried.len() > poses as usize {
            let message = format!("carried.{key} lists {} loads for {poses} poses", carried.len());
            let help = "expected at least one, and at most as many as the set has poses".to_owned();
            return Err(source.error(list.span(), message, Some(help)));
        }
    }
    if let Some(idle) = (0..stated.len()).find(|index| !carried.iter().flatten().any(|c| *c == Some(*index)))
    {
        let message = format!("no pose carries payload {:?}", stated[idle].name);
        let help = "expected its name in carried.identification or carried.verification".to_owned();
        return Err(source.error(tables[idle].span(), message, Some(help)));
    }
    let payload = |(stated, table): (Payload, &Spanned<PayloadTable>)| {
        let factor = table.get_ref().mass_factor.as_ref();
        let factor = factor.map_or(Ok(1.0), |factor| source.positive("payload.mass_factor", factor))?;
        let real = Payload { mass: factor * stated.mass, ..stated.clone() };
        Ok::<_, InputError>(PlannedPayload { stated, real })
    };
    Ok(PayloadPlan {
        payloads: stated.into_iter().zip(tables).map(payload).collect::<Result<_, _>>()?,
        carried,
        order: match file.order {
            None | Some(OrderFile::Blocks) => PayloadOrder::Blocks,
            Some(OrderFile::Cycle) => PayloadOrder::Cycle,
        },
    })
}

//! Tables as Apache Parquet, which pandas, R and DuckDB read with types: one row group, every column optional.

use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::{Type, TypePtr};

use crate::artefact::{Cell, CodecError, Table};

/// What all cells of a column have in common, empty ones aside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shape {
    Numbers,
    Flags,
    Text,
}

/// The table as one Parquet file: numbers as DOUBLE, flags as BOOLEAN, everything else as UTF-8 text; empty cells are null.
///
/// # Errors
/// What keeps the file from being written, such as two columns of one name.
pub fn write(table: &Table) -> Result<Vec<u8>, CodecError> {
    encode(table).map_err(|error| CodecError(format!("cannot write Parquet: {error}")))
}

fn encode(table: &Table) -> Result<Vec<u8>, ParquetError> {
    let shapes: Vec<Shape> = (0..table.columns.len()).map(|column| shape(table, column)).collect();
    let fields = table.columns.iter().zip(&shapes).map(|(name, shape)| field(name, *shape));
    let schema = Type::group_type_builder("table").with_fields(fields.collect::<Result<_, _>>()?).build()?;
    let properties = Arc::new(WriterProperties::builder().build());
    let mut writer = SerializedFileWriter::new(Vec::new(), Arc::new(schema), properties)?;
    let mut rows = writer.next_row_group()?;
    let mut column = 0;
    while let Some(mut slot) = rows.next_column()? {
        fill(slot.untyped(), table, column)?;
        slot.close()?;
        column += 1;
    }
    rows.close()?;
    writer.into_inner()
}

fn shape(table: &Table, column: usize) -> Shape {
    let mut cells = table.rows.iter().map(|row| &row[column]).filter(|cell| !matches!(cell, Cell::Empty(())));
    if cells.clone().all(|cell| matches!(cell, Cell::Number(_))) {
        Shape::Numbers
    } else if cells.all(|cell| matches!(cell, Cell::Flag(_))) {
        Shape::Flags
    } else {
        Shape::Text
    }
}

fn field(name: &str, shape: Shape) -> Result<TypePtr, ParquetError> {
    let (physical, logical) = match shape {
        Shape::Numbers => (Physical::DOUBLE, None),
        Shape::Flags => (Physical::BOOLEAN, None),
        Shape::Text => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
    };
    let builder = Type::primitive_type_builder(name, physical).with_repetition(Repetition::OPTIONAL);
    builder.with_logical_type(logical).build().map(Arc::new)
}

/// Writes the cells of a column; the definition level of a cell is 1 where it has a value.
fn fill(writer: &mut ColumnWriter, table: &Table, column: usize) -> Result<(), ParquetError> {
    let cells = || table.rows.iter().map(|row| &row[column]);
    let levels: Vec<i16> = cells().map(|cell| i16::from(!matches!(cell, Cell::Empty(())))).collect();
    match writer {
        ColumnWriter::DoubleColumnWriter(to) => {
            let values: Vec<f64> = cells().filter_map(Cell::number).collect();
            to.write_batch(&values, Some(&levels), None)?;
        }
        ColumnWriter::BoolColumnWriter(to) => {
            let flag = |cell: &Cell| if let Cell::Flag(flag) = cell { Some(*flag) } else { None };
            let values: Vec<bool> = cells().filter_map(flag).collect();
            to.write_batch(&values, Some(&levels), None)?;
        }
        ColumnWriter::ByteArrayColumnWriter(to) => {
            let filled = cells().filter(|cell| !matches!(cell, Cell::Empty(())));
            let values: Vec<ByteArray> = filled.map(|cell| ByteArray::from(cell.to_string().as_str())).collect();
            to.write_batch(&values, Some(&levels), None)?;
        }
        _ => return Err(ParquetError::General("a column of another type than the schema's".into())),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::Field;

    use super::*;

    #[test]
    fn cells_come_back_with_their_types() {
        let mut table = Table::new(["id", "class", "found", "mixed"]);
        table.push(vec![1.5.into(), "slab".into(), true.into(), 1.0.into()]);
        table.push(vec![f64::NAN.into(), Cell::Empty(()), false.into(), "x".into()]);
        let bytes = write(&table).unwrap();
        let reader = SerializedFileReader::new(bytes::Bytes::from(bytes)).unwrap();
        let rows: Vec<Vec<Field>> = reader
            .get_row_iter(None)
            .unwrap()
            .map(|row| row.unwrap().get_column_iter().map(|(_, field)| field.clone()).collect())
            .collect();
        let text = |text: &str| Field::Str(text.into());
        assert_eq!(rows[0], [Field::Double(1.5), text("slab"), Field::Bool(true), text("1")]);
        assert_eq!(rows[1], [Field::Null, Field::Null, Field::Bool(false), text("x")]);
    }

    #[test]
    fn a_table_without_rows_is_a_file() {
        assert!(write(&Table::new(["a"])).unwrap().starts_with(b"PAR1"));
    }
}

//! `spgs inspect`.

use engine::error::Result;
use engine::file;

use crate::args::InspectArgs;
use crate::{dataset, output};

/// Says what is in a model file or a data set.
pub fn run(args: &InspectArgs) -> Result<()> {
    if args.file.is_dir() && file::Format::of_folder(&args.file).is_none() {
        return dataset::inspect(&args.file, args.json);
    }
    let description = file::describe(&args.file)?;
    if args.json {
        return output::json(&description);
    }
    output::line(description.to_string().trim_end());
    Ok(())
}

//! `spgs inspect`.

mod dataset;

use std::path::Path;

use engine::error::{Error, Result};
use engine::file;

use crate::cli::args::InspectArgs;
use crate::cli::output;

/// Says what is in a model file or a data set.
pub fn run(args: &InspectArgs) -> Result<()> {
    if args.file.is_dir() && file::Format::of_folder(&args.file).is_none() {
        return dataset::inspect(&args.file, args.json).map_err(|error| neither(&args.file, error));
    }
    let description = file::describe(&args.file)?;
    if args.json {
        return output::json(&description);
    }
    output::line(description.to_string().trim_end());
    Ok(())
}

/// A folder without a data set may have been meant to hold a model.
fn neither(folder: &Path, error: Error) -> Error {
    match error {
        Error::Usage { what, found, expected } if what == format!("data set in {}", folder.display()) => {
            let models =
                "a model: meta.json or lod-meta.json (SOG), point_cloud/iteration_N/point_cloud.ply (training run)";
            Error::usage(format!("folder {}", folder.display()), found, format!("{models}; or a data set: {expected}"))
        }
        other => other,
    }
}

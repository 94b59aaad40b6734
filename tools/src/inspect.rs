//! `spgs inspect`.

use engine::error::Result;
use engine::file;

use crate::args::InspectArgs;
use crate::output;

/// Says what is in a model file.
pub fn run(args: &InspectArgs) -> Result<()> {
    let description = file::describe(&args.file)?;
    if args.json {
        return output::json(&description);
    }
    output::line(description.to_string().trim_end());
    Ok(())
}

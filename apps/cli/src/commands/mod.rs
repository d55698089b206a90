//! One file per command. A new command is a file with a struct of options and its `run`, and one line in the list below.

mod fitting;
mod shared;

use crate::Common;

macro_rules! commands {
    ($($(#[$about:meta])* $module:ident :: $name:ident),* $(,)?) => {
        $(mod $module;)*

        /// All commands, in the order of `--help`.
        #[derive(clap::Subcommand)]
        pub enum Command {
            $($(#[$about])* $name($module::$name),)*
        }

        impl Command {
            /// Does what the command says.
            pub fn run(&self, common: &Common) -> anyhow::Result<()> {
                match self {
                    $(Self::$name(command) => command.run(common),)*
                }
            }
        }
    };
}

commands! {
    /// Move a model as a video shows, rigged or not: GLB, videos to look at and a report
    animate::Animate,
    /// Move many models as a list says: resumable, several at a time, with a table at the end
    batch::Batch,
    /// Find the motion alone: model and videos in, one GLB with a clip per video out
    fit::Fit,
    /// Find masks and point tracks in a video, with an overlay video to look at
    cues::Cues,
    /// Measure an animated model against a video or exact truth
    evaluate::Evaluate,
    /// Draw an animated model from several views as a video or picture
    render::Render,
    /// Give a model a skeleton and skin weights: GLB or rig.txt
    rig::Rig,
    /// Draw the picture that an image-to-video model starts from, with its camera
    still::Still,
    /// Have a video made of a model by a service or program of your choice
    generate::Generate,
    /// Give an animated model soft tissue: its clip gains inertia and elasticity, and stays in the rig
    soften::Soften,
    /// Fill a model with tetrahedra: VTU, MSH or npz
    tet::Tet,
    /// Make the example: a creature, its camera and a video of it moving
    example::Example,
    /// Say what this machine offers, and how to get what it lacks
    doctor::Doctor,
    /// List what there is of a kind: formats, metrics, cameras, cues, presets, riggers, models, physics, providers, overlays
    list::List,
}

//! A sweep as an array of SLURM jobs.

/// What a script asks of the cluster.
#[derive(Debug, Clone, PartialEq)]
pub struct SlurmOptions {
    /// The sweep's file, as the jobs see it.
    pub sweep: String,
    /// The folder of the sweep, as the jobs see it.
    pub folder: String,
    /// Number of jobs.
    pub shards: usize,
    /// Cores of each.
    pub cores: usize,
    /// Limit of each, as SLURM writes it (`HH:MM:SS`).
    pub time: String,
}

/// The script for `sbatch`: job i computes shard i. A job whose node fails, or that is preempted, SLURM queues again; it goes
/// on where its journal ends.
pub fn slurm_script(name: &str, options: &SlurmOptions) -> String {
    let SlurmOptions {
        sweep,
        folder,
        shards,
        cores,
        time,
    } = options;
    let (sweep, folder) = (quote(sweep), quote(folder));
    // One line, and nothing that SLURM would read as another option.
    let name: String = name
        .chars()
        .map(|c| if c.is_alphanumeric() { c } else { '_' })
        .collect();
    format!(
        "#!/bin/bash\n\
         #SBATCH --job-name={name}\n\
         #SBATCH --array=1-{shards}\n\
         #SBATCH --ntasks=1\n\
         #SBATCH --cpus-per-task={cores}\n\
         #SBATCH --time={time}\n\
         #SBATCH --requeue\n\
         #\n\
         # Submit, and make the table when all jobs are done:\n\
         #\n\
         #   job=$(sbatch --parsable THIS_SCRIPT)\n\
         #   sbatch --dependency=afterok:$job --wrap \"flyvine merge {sweep} --out {folder}\"\n\
         #\n\
         # Submitting it again computes what is missing, and nothing twice.\n\
         set -euo pipefail\n\
         export RAYON_NUM_THREADS=\"${{SLURM_CPUS_PER_TASK:-{cores}}}\"\n\
         exec flyvine sweep {sweep} --out {folder} --shard \"${{SLURM_ARRAY_TASK_ID}}/{shards}\"\n"
    )
}

/// A word that the shell takes as it is.
fn quote(word: &str) -> String {
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_paths_cannot_break_the_script() {
        let options = SlurmOptions {
            sweep: "it's.toml".into(),
            folder: "out dir".into(),
            shards: 8,
            cores: 4,
            time: "01:00:00".into(),
        };
        let script = slurm_script("wind\n#SBATCH --exclusive", &options);
        assert!(script.contains(r"flyvine sweep 'it'\''s.toml' --out 'out dir' --shard"));
        assert!(script.contains("--job-name=wind__SBATCH___exclusive\n"));
        assert!(script.contains("--array=1-8\n"));
    }
}

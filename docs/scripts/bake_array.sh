#!/bin/bash
# Light by a Slurm job array: sbatch bake_array.sh STORE OPTION…
#SBATCH --array=1-64
#SBATCH --cpus-per-task=2
#SBATCH --mem=4G
set -euo pipefail
store=$1
shift
parts=${SLURM_ARRAY_TASK_COUNT:-64}
orograph bake "$store" "$@" --part "$SLURM_ARRAY_TASK_ID/$parts" --jobs "${SLURM_CPUS_PER_TASK:-2}" --max-memory 3GiB

#!/bin/bash
# What follows the parts: sbatch --dependency=afterok:JOB finish_array.sh STORE FILE…
#SBATCH --cpus-per-task=16
#SBATCH --mem=16G
set -euo pipefail
store=$1
shift
orograph build "$@" -o "$store" --finish --jobs "${SLURM_CPUS_PER_TASK:-2}" --max-memory 3GiB

#!/bin/sh
#SBATCH --job-name=parfocal
#SBATCH --array=1-64
#SBATCH --cpus-per-task=2
#SBATCH --mem=8G
# With a GPU a task: #SBATCH --gpus-per-task=1

# Submitted by: sbatch slurm.sh LIST OUT
set -eu
exec parfocal batch "$1" -o "$2" --resume --quiet --shard "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT"

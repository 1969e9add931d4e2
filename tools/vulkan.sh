# shellcheck shell=bash
# Finds the Vulkan drivers and layers of this machine. The other tools source it.

PATH=$PATH:/usr/sbin:/sbin # ldconfig is in /usr/sbin, which may be missing from the PATH of users

# Container runtimes mount the NVIDIA driver here. The dynamic loader and the Vulkan loader may not search this folder.
container_driver=/usr/local/nvidia

# in_loader_path LIB: succeeds if the dynamic loader finds LIB by name
in_loader_path() {
  local folder folders
  IFS=: read -ra folders <<<"${LD_LIBRARY_PATH:-}"
  for folder in "${folders[@]}"; do
    [[ ! -e $folder/$1 ]] || return 0
  done
  [[ $(ldconfig -p) == *$'\t'"$1 "* ]]
}

have_loader() { in_loader_path libvulkan.so.1; }

# icd_works JSON: succeeds if the driver of this manifest exists; containers often have only the manifest
icd_works() {
  local library
  library=$(sed -n 's/.*"library_path"[^"]*"\([^"]*\)".*/\1/p' "$1" 2>/dev/null)
  case $library in
    '') return 1 ;;
    /*) [[ -e $library ]] ;;
    */*) [[ -e $(dirname "$1")/$library ]] ;;
    *) in_loader_path "$library" ;;
  esac
}

# have_icd: succeeds if the Vulkan loader can find a working driver
have_icd() {
  local named=${VK_DRIVER_FILES:-${VK_ICD_FILENAMES:-}} icd icds
  if [[ -n $named ]]; then
    IFS=: read -ra icds <<<"$named"
  else
    icds=({/etc,/usr/local/etc,/usr/local/share,/usr/share,"${XDG_DATA_HOME:-${HOME:-}/.local/share}"}/vulkan/icd.d/*.json)
  fi
  for icd in "${icds[@]}"; do
    ! icd_works "$icd" || return 0
  done
  return 1
}

# use_driver: selects the driver of the container unless the environment names one; fails if there is no working driver
use_driver() {
  local icd=$container_driver/share/vulkan/icd.d/nvidia_icd.json
  if [[ -d $container_driver/lib64 ]]; then
    export LD_LIBRARY_PATH=${LD_LIBRARY_PATH:+$LD_LIBRARY_PATH:}$container_driver/lib64
  fi
  if [[ -z ${VK_DRIVER_FILES:-${VK_ICD_FILENAMES:-}} ]] && icd_works "$icd"; then
    export VK_DRIVER_FILES=$icd VK_ICD_FILENAMES=$icd
  fi
  have_icd
}

# mesa_driver NAME: prints the path of the manifest of one of Mesa's drivers, or nothing
mesa_driver() {
  local icd
  for icd in /{usr/share,etc}/vulkan/icd.d/"$1"_icd*.json; do
    if icd_works "$icd"; then
      echo "$icd"
      return
    fi
  done
}

# Mesa's software driver, and its driver for AMD GPUs
lavapipe() { mesa_driver lvp; }
radv() { mesa_driver radeon; }

have_validation() {
  local layers=({/etc,/usr/share,/usr/local/share}/vulkan/explicit_layer.d/VkLayer_khronos_validation.json)
  local layer
  for layer in "${layers[@]}" "${VK_LAYER_PATH:-/nowhere}/VkLayer_khronos_validation.json"; do
    [[ ! -e $layer ]] || return 0
  done
  return 1
}

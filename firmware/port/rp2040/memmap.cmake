# memmap(OUT ORIGIN ROOM): the SDK's linker script for an image at ORIGIN, an address, with a stack of both scratch banks:
# the second core is never started, and checking a signature takes more than one bank.
function(memmap out origin room)
  file(READ ${PICO_SDK_PATH}/src/rp2_common/pico_crt0/rp2040/memmap_default.ld script)
  foreach(change
      "INCLUDE \"pico_flash_region.ld\"|FLASH(rx) : ORIGIN = ${origin}, LENGTH = ${room}"
      "SCRATCH_X(rwx) : ORIGIN = 0x20040000, LENGTH = 4k|SCRATCH_X(rwx) : ORIGIN = 0x20040000, LENGTH = 0"
      "SCRATCH_Y(rwx) : ORIGIN = 0x20041000, LENGTH = 4k|SCRATCH_Y(rwx) : ORIGIN = 0x20040000, LENGTH = 8k")
    string(REPLACE "|" ";" change "${change}")
    list(GET change 0 before)
    list(GET change 1 after)
    string(FIND "${script}" "${before}" at)
    if(at EQUAL -1)
      message(FATAL_ERROR "the SDK's linker script has no '${before}': it is not that of Pico SDK 2.1")
    endif()
    string(REPLACE "${before}" "${after}" script "${script}")
  endforeach()
  file(WRITE ${out} "${script}")
endfunction()

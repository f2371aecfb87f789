/// TinyUSB as both ports use it: one vendor interface (bulk), one DFU interface. The port's build names the controller.
#ifndef TUSB_CONFIG_H
#define TUSB_CONFIG_H

#ifndef CFG_TUSB_MCU
#error "the port's build says which controller: -DCFG_TUSB_MCU=OPT_MCU_..."
#endif
#ifndef CFG_TUSB_OS
#define CFG_TUSB_OS OPT_OS_NONE
#endif
#define CFG_TUSB_RHPORT0_MODE  OPT_MODE_DEVICE
#define CFG_TUD_ENABLED        1
#define CFG_TUD_MAX_SPEED      OPT_MODE_FULL_SPEED
#define CFG_TUD_ENDPOINT0_SIZE 64

#define CFG_TUD_VENDOR            1
#define CFG_TUD_VENDOR_EPSIZE     64 // a larger one stalls on exact multiples of the packet size
#define CFG_TUD_VENDOR_RX_BUFSIZE 64 // a packet is on its way while this one is read or filled; the app has a queue
#define CFG_TUD_VENDOR_TX_BUFSIZE 64

#define CFG_TUD_DFU              1
#define CFG_TUD_DFU_XFER_BUFSIZE 256 // wTransferSize: a flash page

#endif

/* client/tilery_main.c: the program `tilery`: the command line, or the child that reads a model.
 *
 * The child is this same program under an argument that nobody types by chance.
 */
#include <string.h>

#include "client/cli.h"
#include "client/import.h"
#include "common/process.h"

int main(int argc, char **argv)
{
    process_prepare();
    if (argc > 1 && strcmp(argv[1], IMPORT_CHILD_ARGUMENT) == 0)
        return import_child_main(argc, argv);
    return cli_main(argc, argv);
}
